"""Rendering of the generated person: meshes, strands, light."""
