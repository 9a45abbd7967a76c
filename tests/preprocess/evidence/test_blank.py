"""Blank frames and fades. Reference: fades made as convex combinations of the picture with one color."""

from __future__ import annotations

import numpy as np
import pytest

from preprocess.evidence.blank import blank_frames, faded_frames, runs, thumbnail


def scene(count, seed=0):
    """A picture in which something moves."""
    generator = np.random.default_rng(seed)
    base = generator.integers(40, 220, (8, 8, 3)).repeat(4, axis=0).repeat(4, axis=1)
    frames = np.repeat(base[None], count, axis=0).astype(np.float64)
    for row in range(count):
        frames[row, 10:16, (row // 2) % 20 : (row // 2) % 20 + 6] = 230
    return frames


def stored(frames):
    return np.round(np.clip(frames, 0, 255)).astype(np.uint8)


@pytest.mark.parametrize("color", [0, 128, 255])
@pytest.mark.parametrize("reverse", [False, True])
def test_blank_and_fade_at_either_end(color, reverse):
    frames = scene(60)
    weights = np.concatenate((np.zeros(15), np.arange(1, 9) / 9, np.ones(37)))[:, None, None, None]
    clip = stored(weights * frames + (1 - weights) * color)
    expected_blank, expected_fade = np.arange(60) < 15, (np.arange(60) >= 15) & (np.arange(60) < 23)
    if reverse:
        clip, expected_blank, expected_fade = clip[::-1], expected_blank[::-1], expected_fade[::-1]
    blank = blank_frames(clip)
    np.testing.assert_array_equal(blank, expected_blank)
    faded = faded_frames(clip, blank)
    # At 8/9 of the contrast a frame is just faded.
    assert np.array_equal(faded, expected_fade), np.flatnonzero(faded)


def test_a_fade_without_blank_frames():
    weights = np.concatenate((np.linspace(0.2, 1, 8), np.ones(31)))[:, None, None, None]
    faded = faded_frames(stored(weights * scene(39)), np.zeros(39, bool))
    np.testing.assert_array_equal(np.flatnonzero(faded), np.arange(7))


def test_pictures_that_just_begin_or_change_are_no_fades():
    clip = stored(scene(40))
    assert not blank_frames(clip).any() and not faded_frames(clip, np.zeros(40, bool)).any()
    brighter = stored(scene(40) * np.linspace(0.8, 1, 40)[:, None, None, None])
    assert not faded_frames(brighter, np.zeros(40, bool)).any(), "an exposure that settles"
    short = stored(scene(3))
    assert not faded_frames(short, np.zeros(3, bool)).any()


def test_a_dip_to_black_in_the_middle():
    weights = np.ones(60)
    weights[20:25], weights[25:30], weights[30:35] = np.linspace(0.8, 0.1, 5), 0, np.linspace(0.1, 0.8, 5)
    clip = stored(weights[:, None, None, None] * scene(60))
    blank = blank_frames(clip)
    assert np.flatnonzero(blank).tolist() == list(range(25, 30))
    assert np.flatnonzero(faded_frames(clip, blank)).tolist() == [*range(20, 25), *range(30, 35)]


def test_runs():
    assert runs([True, True, False, True]) == [(0, 1), (3, 3)] and runs([]) == [] and runs([False]) == []


def test_thumbnails():
    assert thumbnail(np.full((90, 160, 3), 7, np.uint8)).tolist() == np.full((32, 32, 3), 7).tolist()
