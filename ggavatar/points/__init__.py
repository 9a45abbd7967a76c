"""Canonical points: surface, deformation and shading (PointAvatar)."""
