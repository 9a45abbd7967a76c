"""Canonical points: their surface, how they move, and how they are shaded (PointAvatar)."""
