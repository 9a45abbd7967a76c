"""Whether masks can be a person's. Reference: drawn persons and the ways in which masks of them are wrong."""

from __future__ import annotations

import numpy as np
import pytest

from preprocess.masks.checks import describe, find_fault, is_empty, measure_mask

SIZE = 128
ROWS, COLUMNS = np.mgrid[:SIZE, :SIZE]
FACE = np.array([[44.0, 40], [84, 90]])


def person(x=64, top=20):
    """Head and shoulders down to the lower border."""
    head = ((ROWS - top - 44) / 44) ** 2 + ((COLUMNS - x) / 30) ** 2 <= 1
    shoulders = (ROWS > 100) & (np.abs(COLUMNS - x) < 56)
    return np.where(head | shoulders, 255, 0).astype(np.uint8)


def face_only():
    return np.where(((ROWS - 65) / 28) ** 2 + ((COLUMNS - 64) / 22) ** 2 <= 1, 255, 0).astype(np.uint8)


def close_up():
    """A face that fills the picture up to its corners."""
    return np.where((ROWS - 64) ** 2 + (COLUMNS - 64) ** 2 < 80**2, 255, 0).astype(np.uint8)


RIGHT = {
    "person": person(),
    "hair cut by the border": person(top=-15),
    "face only": face_only(),
    "close-up": close_up(),
}
WRONG = {
    "empty": np.zeros((SIZE, SIZE), np.uint8),
    "everywhere": np.full((SIZE, SIZE), 255, np.uint8),
    "inverted": 255 - person(),
    "elsewhere": np.roll(person(), 90, axis=1),
}


@pytest.mark.parametrize("name", RIGHT)
@pytest.mark.parametrize("seen", [True, False])
def test_right_masks_pass(name, seen):
    assert find_fault([measure_mask(RIGHT[name], FACE if seen else None)] * 5) is None


@pytest.mark.parametrize("fault", WRONG)
def test_wrong_masks_are_named(fault):
    measures = [measure_mask(WRONG[fault], FACE)] * 5
    assert find_fault(measures) == fault
    words = {"empty": "are empty", "everywhere": "separate nothing", "inverted": "are inverted", "elsewhere": "do not"}
    assert words[fault] in describe(fault, measures)


@pytest.mark.parametrize("fault", ["empty", "everywhere", "inverted"])
def test_without_a_face_the_border_and_the_middle_decide(fault):
    assert find_fault([measure_mask(WRONG[fault])] * 5) == fault
    assert find_fault([measure_mask(WRONG["elsewhere"])] * 5) is None, "a person may stand aside"


def test_inverted_close_ups_and_cut_hair_are_inverted():
    assert find_fault([measure_mask(255 - person(top=-15), FACE)] * 3) == "inverted"


def test_masks_of_nearly_everything_separate_nothing():
    assert find_fault([measure_mask(np.where(ROWS + COLUMNS > 230, 0, 255).astype(np.uint8), FACE)] * 3) == "everywhere"


def test_some_bad_frames_do_not_condemn_a_clip():
    """A face that is found in hardly any frame does not decide either."""
    measures = [measure_mask(person(), FACE)] * 9 + [
        measure_mask(WRONG["empty"]),
        measure_mask(WRONG["inverted"], FACE),
    ]
    assert find_fault(measures) is None
    assert find_fault([measure_mask(person())] * 9 + [measure_mask(person(), FACE + 1000)]) is None


def test_empty_masks():
    speck = np.zeros((SIZE, SIZE), np.uint8)
    speck[5:8, 5:8] = 255
    assert is_empty(speck) and is_empty(np.full((SIZE, SIZE), 127, np.uint8)) and not is_empty(face_only())
