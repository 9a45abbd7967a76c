"""The rasterizer of flat discs (PointAvatar)."""
