"""Drawing the generated person: meshes, strands, light."""
