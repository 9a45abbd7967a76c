"""Motion of the torso, tracked beside the head."""
