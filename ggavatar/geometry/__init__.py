"""Rotations, transforms, triangles and surfaces as pure functions."""
