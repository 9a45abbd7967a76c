"""Gaussians bound to a mesh: initialization, binding, offsets, density control, colors."""
