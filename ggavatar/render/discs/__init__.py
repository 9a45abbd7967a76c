"""Flat discs for PointAvatar: a rasterizer of their own."""
