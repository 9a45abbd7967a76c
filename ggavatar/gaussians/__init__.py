"""Gaussians on a mesh: first rows, binding, offsets, density control, colors."""
