"""Conversion to sRGB. References: published values, and the standards' formulas written out for one color in float64.

Also covers `ggavatar/pictures/transfer.py`, `ggavatar/pictures/gamut.py` and `ggavatar/pictures/tone_mapping.py`.
"""

from __future__ import annotations

import numpy as np
import pytest

from ggavatar.pictures.color import ColorSpace, UnsupportedColorError, conversion_to_srgb, tagged_color_space
from ggavatar.pictures.gamut import BT709, BT2020, PRIMARIES, matrix_to_srgb, rgb_to_xyz
from ggavatar.pictures.tone_mapping import tone_mapped
from ggavatar.pictures.transfer import (
    hlg_to_scene,
    linear_to_srgb,
    luminance_to_pq,
    pq_to_luminance,
    srgb_to_linear,
)
from tests.support.hdr_reference import hdr_to_srgb, pq_luminance, pq_signal

PQ, HLG = 16, 18


def at(curve, value):
    return float(curve(np.array([value]))[0])


def test_curves_at_published_points():
    """BT.2408-7, table 1: reference white of 203 cd/m² is 58 % PQ and 75 % HLG; 1000 cd/m² are 75 % PQ."""
    assert at(luminance_to_pq, 203.0) == pytest.approx(0.58, abs=0.002)
    assert at(luminance_to_pq, 1000.0) == pytest.approx(0.7518, abs=1e-4)
    assert at(luminance_to_pq, 10000.0) == pytest.approx(1, abs=1e-12)
    scene = at(hlg_to_scene, 0.75)
    assert 1000 * scene**1.2 == pytest.approx(203, abs=1), "the display of 1000 cd/m² has the system gamma 1.2"
    assert at(hlg_to_scene, 0.5) == pytest.approx(1 / 12) and at(hlg_to_scene, 1.0) == pytest.approx(1)
    assert at(srgb_to_linear, 0.5) == pytest.approx(0.21404114, abs=1e-8)


def test_curves_and_their_inverses():
    signal = np.linspace(0, 1, 1001)
    np.testing.assert_allclose(linear_to_srgb(srgb_to_linear(signal)), signal, atol=1e-6)
    np.testing.assert_allclose(luminance_to_pq(pq_to_luminance(signal)), signal, atol=1e-6)


def test_published_matrices():
    """BT.709 to XYZ from IEC 61966-2-1; BT.2020 to BT.709 from Recommendation ITU-R BT.2087, section 3 (inverted)."""
    np.testing.assert_allclose(
        rgb_to_xyz(BT709),
        [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]],
        atol=2e-4,
    )
    np.testing.assert_allclose(
        np.linalg.inv(matrix_to_srgb(BT2020)),
        [[0.6274, 0.3293, 0.0433], [0.0691, 0.9195, 0.0114], [0.0164, 0.0880, 0.8956]],
        atol=1e-4,
    )


@pytest.mark.parametrize("code", PRIMARIES)
def test_white_stays_white(code):
    np.testing.assert_allclose(matrix_to_srgb(PRIMARIES[code][1]) @ [1, 1, 1], [1, 1, 1], atol=1e-9)


def test_tone_curve_leaves_the_dark_alone_and_reaches_the_target():
    light = np.linspace(0, 1000, 4001)
    mapped = tone_mapped(light, 1000.0)
    knee = pq_luminance((1.5 * pq_signal(203) / pq_signal(1000) - 0.5) * pq_signal(1000))
    np.testing.assert_allclose(mapped[light < knee], light[light < knee], rtol=1e-9)
    assert mapped[-1] == pytest.approx(203) and (np.diff(mapped) > 0).all() and (mapped <= light + 1e-9).all()
    np.testing.assert_allclose(np.diff(mapped, 2), 0, atol=0.03)
    np.testing.assert_array_equal(tone_mapped(np.array([10.0, 203, 400]), 150.0), [10, 203, 203])


@pytest.mark.parametrize("transfer", [PQ, HLG])
@pytest.mark.parametrize(("dtype", "top"), [(np.uint8, 255), (np.uint16, 65535)])
def test_hdr_follows_the_formulas(transfer, dtype, top):
    values = np.random.default_rng(3).integers(0, top + 1, (40, 30, 3)).astype(dtype)
    conversion = conversion_to_srgb(tagged_color_space(9, transfer))
    assert conversion is not None and "tone-mapped" in conversion.words
    expected = [[hdr_to_srgb(pixel / top, transfer) for pixel in row] for row in values.astype(float)]
    found = conversion.apply(values)
    assert found.dtype == np.uint8
    assert np.abs(found.astype(int) - np.array(expected) * 255).max() <= 0.75


def test_the_stated_peak_decides_the_curve():
    """Content that never exceeds reference white is not compressed at all."""
    white = np.full((1, 1, 3), round(pq_signal(203) * 65535), np.uint16)
    assert conversion_to_srgb(tagged_color_space(9, PQ, 203.0)).apply(white).tolist() == [[[255] * 3]]
    assert conversion_to_srgb(tagged_color_space(9, PQ)).apply(white).tolist() == [[[229] * 3]]
    bright = np.full((1, 1, 3), round(pq_signal(4000) * 65535), np.uint16)
    assert conversion_to_srgb(tagged_color_space(9, PQ, 4000.0)).apply(bright).tolist() == [[[255] * 3]]


def test_display_p3_in_closed_form():
    """Through XYZ with published numbers: Display P3 to XYZ by SMPTE EG 432-1, XYZ to sRGB by IEC 61966-2-1."""
    to_xyz = np.array([[0.48657, 0.26567, 0.19822], [0.22897, 0.69174, 0.07929], [0, 0.04511, 1.04394]])
    to_srgb = np.array([[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]])
    values = np.random.default_rng(4).integers(0, 256, (16, 16, 3)).astype(np.uint8)
    signal = values / 255
    light = np.where(signal <= 0.04045, signal / 12.92, ((signal + 0.055) / 1.055) ** 2.4) @ (to_srgb @ to_xyz).T
    light = np.clip(light, 0, 1)
    expected = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055) * 255
    conversion = conversion_to_srgb(tagged_color_space(12, 13))
    assert conversion is not None
    assert np.abs(conversion.apply(values) - expected).max() < 1.2


def test_what_is_srgb_already_is_not_converted():
    for transfer in (0, 1, 2, 6, 7, 11, 12, 13, 14, 15):
        assert conversion_to_srgb(tagged_color_space(1, transfer)) is None
        assert conversion_to_srgb(tagged_color_space(2, transfer)) is None


def test_gray_stays_gray_in_a_wider_gamut():
    gray = np.repeat(np.arange(256, dtype=np.uint8)[None, :, None], 3, axis=2)
    for code in PRIMARIES:
        conversion = conversion_to_srgb(tagged_color_space(code, 14))
        if conversion is not None:
            np.testing.assert_array_equal(conversion.apply(gray), gray)


def test_pure_gamma():
    conversion = conversion_to_srgb(ColorSpace(gamma=1.0))
    assert conversion is not None
    expected = round(255 * (1.055 * (100 / 255) ** (1 / 2.4) - 0.055))
    assert conversion.apply(np.full((1, 1, 3), 100, np.uint8)).tolist() == [[[expected] * 3]]
    assert conversion_to_srgb(tagged_color_space(1, 4)) is not None, "gamma 2.2"


def test_what_cannot_be_converted_is_named():
    for primaries, transfer, words in ((9, 10, "curve with code point 10"), (10, 1, "primaries with code point 10")):
        with pytest.raises(UnsupportedColorError, match=words):
            tagged_color_space(primaries, transfer)
    with pytest.raises(UnsupportedColorError, match="line"):
        conversion_to_srgb(ColorSpace(chromaticities=(0.3, 0.3, 0.3, 0.3, 0.3, 0.3, 0.3, 0.3)))
    with pytest.raises(UnsupportedColorError, match="chromaticities"):
        conversion_to_srgb(ColorSpace(chromaticities=(0.0,) * 8))
