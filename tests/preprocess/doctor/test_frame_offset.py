"""Means of brightness changes where the face is outside the image; offsets themselves are tested in test_diagnosis."""

from __future__ import annotations

import numpy as np

from preprocess.doctor.frame_offset import mean_change


def test_a_face_that_is_never_in_the_image_changes_infinitely_much():
    """It used to be numpy's mean of an empty slice: a warning, and NaN in comparisons."""
    assert mean_change(np.full(3, np.nan)) == np.inf == mean_change(np.zeros(0))
    assert mean_change(np.array([1.0, np.nan, 4.0])) == 2.5
