"""The numbers every backend shares (3D Gaussian splatting, Kerbl et al. 2023; gsplat 1.5)."""

from __future__ import annotations

NEAR = 0.01
"""Gaussians whose center is nearer than this are not drawn, m of camera z."""

LOW_PASS = 0.3
"""Added to both variances of every projected Gaussian, px²."""

MAX_ALPHA = 0.99
"""A Gaussian never covers a pixel more than this."""

MIN_ALPHA = 1 / 255
"""A Gaussian that covers a pixel less than this is not blended there."""

MIN_TRANSMITTANCE = 1e-4
"""A pixel is finished before the Gaussian that would let less light through than this."""

CLAMP_MARGIN = 0.3
"""The Jacobian is evaluated no further outside of the image than this fraction of half its width or height."""

TINY_NORM = 1e-12
"""Quaternions shorter than this count as this long, which makes the zero quaternion the identity."""
