"""Cuts. Reference: where two made-up scenes were joined."""

from __future__ import annotations

import numpy as np

from preprocess.evidence.cuts import changes, color_distance, color_histogram, find_cuts
from tests.preprocess.evidence.test_blank import scene, stored


def test_a_joined_scene_is_a_cut():
    clip = np.concatenate((stored(scene(30)), stored(scene(30, seed=1)), stored(scene(20, seed=2))))
    assert find_cuts(clip) == [30, 60]
    assert find_cuts(stored(scene(40))) == []
    assert find_cuts(clip[:1]) == [] and find_cuts(clip[:0]) == []


def test_motion_is_no_cut():
    """A picture that shifts by a sixteenth of its width in every frame changes as much, but always."""
    base = stored(scene(1))[0]
    clip = np.stack([np.roll(base, 2 * row, axis=1) for row in range(40)])
    assert changes(clip)[1:].min() > 6 and find_cuts(clip) == []


def test_colors():
    red, blue = np.zeros((1, 4, 4, 3), np.uint8), np.zeros((1, 4, 4, 3), np.uint8)
    red[..., 0], blue[..., 2] = 250, 250
    assert color_histogram(red).sum() == 1
    assert color_distance(color_histogram(red), color_histogram(blue)) == 1
    assert color_distance(color_histogram(red), color_histogram(np.concatenate((red, blue)))) == 0.5
