"""How well an avatar shows what somebody else's face shows."""
