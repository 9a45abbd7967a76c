"""Memory layout of records and sums, and the constants that the kernels share.

Triton reads a global only if it is a `tl.constexpr`; host code takes `.value`.
"""

from __future__ import annotations

import math

import triton.language as tl

from ggavatar.render import constants

TILE = tl.constexpr(16)
"""Pixels along a side of a tile."""

CHUNK = tl.constexpr(8)
"""Gaussians that a tile blends at a time; with 16 the backward kernel runs out of registers."""

WHITEN_XX, WHITEN_XY, WHITEN_YY = tl.constexpr(0), tl.constexpr(1), tl.constexpr(2)
X, Y, LOG_OPACITY = tl.constexpr(3), tl.constexpr(4), tl.constexpr(5)
RED, GREEN, BLUE, DEPTH = tl.constexpr(6), tl.constexpr(7), tl.constexpr(8), tl.constexpr(9)
RECORD = tl.constexpr(12)
"""Offsets in the record of a Gaussian, and its length in floats (48 bytes).

u = WHITEN_XX dx + WHITEN_XY dy and v = WHITEN_YY dy give log2 alpha = LOG_OPACITY − u² − v². The upper triangle of the
whitening matrix keeps the width of long thin Gaussians, which a conic loses in float32. X and Y are the center in px.
"""

TO_RED, TO_GREEN, TO_BLUE, TO_DEPTH = tl.constexpr(0), tl.constexpr(1), tl.constexpr(2), tl.constexpr(3)
TO_LOG_ALPHA, TO_U, TO_V = tl.constexpr(4), tl.constexpr(5), tl.constexpr(6)
TO_UU, TO_UV, TO_VV = tl.constexpr(7), tl.constexpr(8), tl.constexpr(9)
SUMS = tl.constexpr(10)
"""Offsets in the sums of a Gaussian over the pixels of a tile, and their number.

Features are summed with their blending weight; the rest is w, w·u, … w·v², with w the gradient of log alpha.
"""

POSE_SUMS = tl.constexpr(16)
"""Row length of the sums for the pose: rotation row by row, translation, camera center; the last one is unused."""

PAIRS, FAULTS, STATUS = tl.constexpr(0), tl.constexpr(1), tl.constexpr(2)
"""Offsets in the status of a rendering, and its length: pairs of Gaussian and tile, bits of inputs that are faulty."""

NEAR, LOW_PASS = tl.constexpr(constants.NEAR), tl.constexpr(constants.LOW_PASS)
MAX_ALPHA, MIN_ALPHA = tl.constexpr(constants.MAX_ALPHA), tl.constexpr(constants.MIN_ALPHA)
MIN_TRANSMITTANCE = tl.constexpr(constants.MIN_TRANSMITTANCE)
CLAMP_MARGIN, MIN_NORM = tl.constexpr(constants.CLAMP_MARGIN), tl.constexpr(constants.MIN_NORM)

WHITEN = tl.constexpr(math.sqrt(0.5 * math.log2(math.e)))
"""Factor from standard deviations to u and v, so that exp(−½ d²) = 2^(−u² − v²)."""

TWO_LN2 = tl.constexpr(2 * math.log(2))
LOG2_255 = tl.constexpr(math.log2(255))
SLACK_PX = tl.constexpr(0.01)
"""Tolerance by which tiles are included despite rounding, px."""

MAX_DETERMINANT = tl.constexpr(1e37)
"""Gaussians whose image covariance has a larger determinant (px⁴) would overflow and are culled."""

LARGEST = tl.constexpr(3.4028234e38)
"""The largest finite float32."""
