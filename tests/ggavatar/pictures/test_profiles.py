"""ICC profiles. Reference: Display P3 in closed form (`conversion_to_srgb`, tested against published matrices)."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import ImageCms

from ggavatar.pictures.color import conversion_to_srgb, tagged_color_space
from ggavatar.pictures.profiles import profile_conversion
from tests.support.pictures import display_p3_profile


def test_display_p3_profile_agrees_with_the_formula():
    values = np.random.default_rng(5).integers(0, 256, (32, 32, 3)).astype(np.uint8)
    found, formula = profile_conversion(display_p3_profile()), conversion_to_srgb(tagged_color_space(12, 13))
    assert found is not None and formula is not None
    assert found.mode == "RGB" and found.name == "Display P3 of a test"
    assert np.abs(found.apply(values).astype(int) - formula.apply(values)).max() <= 2
    assert np.abs(found.apply(values).astype(int) - values).max() > 20


def test_srgb_is_left_alone():
    assert profile_conversion(ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()) is None


def test_other_spaces_and_damaged_profiles_are_refused():
    lab = ImageCms.ImageCmsProfile(ImageCms.createProfile("LAB")).tobytes()
    for damaged in (b"", b"x" * 200, display_p3_profile()[:150], lab):
        with pytest.raises(ValueError, match="unusable ICC profile"):
            profile_conversion(damaged)
