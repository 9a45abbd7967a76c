"""Differentiable rasterizers of 3D Gaussians: three backends with one interface, chosen by `backends.pick`."""
