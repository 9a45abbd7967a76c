"""Differentiable rasterizers of 3D Gaussians: four backends with one interface, chosen by `backends.pick`."""
