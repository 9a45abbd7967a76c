"""Camera orbits and driving sequences: what an avatar is rendered with besides its own capture."""
