"""Evidence that a frame shows the person: the face, the picture itself, and who it is."""
