"""The strip of dropped frames: any reason in OpenCV's characters, and a bounded height."""

from __future__ import annotations

import pytest
from hypothesis import given

from preprocess.doctor.preview import LINE, MAX_LINES, drawable, dropped_strip
from tests.support.hostile_names import TEXTS, patient


@patient
@given(TEXTS)
def test_captions_have_the_characters_of_the_fonts(text: str) -> None:
    """Hershey's fonts draw ASCII from the space to the tilde."""
    assert all(" " <= character <= "~" for character in drawable(text))


@pytest.mark.parametrize(
    ("text", "caption"),
    [("no face", "no face"), ("Zoë Łukasz", "Zoe ?ukasz"), ("张\n\x1b三", "? ??"), ("½ frame", "1?2 frame")],
)
def test_what_is_drawn(text: str, caption: str) -> None:
    assert drawable(text) == caption


def test_a_thousand_reasons_make_a_small_strip() -> None:
    dropped = [{"frame": frame, "reason": f"\x1b[31m\n{frame}"} for frame in range(1000)]
    strip = dropped_strip(dropped, 400)
    assert strip.shape == (LINE * MAX_LINES + 8, 400, 3) and strip.any()
    assert dropped_strip(dropped[:2], 400).shape[0] == LINE * 2 + 8
