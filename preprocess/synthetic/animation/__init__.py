"""What the generated person does in front of the camera."""
