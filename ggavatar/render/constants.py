"""Constants of rasterization that all backends share (3D Gaussian splatting, Kerbl et al. 2023; gsplat 1.5)."""

from __future__ import annotations

NEAR = 0.01
"""Near plane: Gaussians whose center has a smaller camera z are culled, m."""

LOW_PASS = 0.3
"""Low-pass filter: added to both variances of every projected Gaussian, px²."""

MAX_ALPHA = 0.99
"""Upper limit of a Gaussian's alpha in a pixel."""

MIN_ALPHA = 1 / 255
"""A Gaussian with a smaller alpha in a pixel is not blended there."""

MIN_TRANSMITTANCE = 1e-4
"""A pixel is finished before the Gaussian that would reduce its transmittance below this."""

CLAMP_MARGIN = 0.3
"""The Jacobian is evaluated no further outside the image than this fraction of half its width or height."""

MIN_NORM = 1e-12
"""Lower limit of a quaternion's norm in its normalization; it makes the zero quaternion the identity rotation."""
