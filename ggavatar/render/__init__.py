"""Differentiable rasterizers of 3D Gaussians: one call, three backends; `ggavatar.render.backends` chooses."""
