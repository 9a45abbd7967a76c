"""The constants of rasterization as literals: 3D Gaussian splatting's code (Kerbl et al. 2023) and gsplat 1.5."""

from __future__ import annotations

from ggavatar.render import constants


def test_constants_are_the_published_ones() -> None:
    assert constants.LOW_PASS == 0.3  # 3DGS: added to the diagonal of the image covariance, px²
    assert constants.MAX_ALPHA == 0.99  # 3DGS: min(0.99, o · exp(…))
    assert constants.MIN_ALPHA == 1 / 255  # 3DGS: skipped below
    assert constants.MIN_TRANSMITTANCE == 1e-4  # 3DGS: a pixel is finished
    assert constants.NEAR == 0.01  # gsplat: near_plane
    assert constants.CLAMP_MARGIN == 0.3  # gsplat: 0.3 of half the image beyond its edges
