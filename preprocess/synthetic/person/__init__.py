"""Appearance of the generated person: shape, skin, hair, clothes."""
