"""Flat discs for PointAvatar: a rasteriser of their own."""
