"""Facial codes are a view of the sequence: read, changed and put back."""

from __future__ import annotations

import dataclasses

import numpy as np

from evaluate.motion.facial_codes import facial_codes, facial_layout, with_facial_codes
from tests.support.performances import motion


def test_codes_are_put_back_where_they_were() -> None:
    sequence = dataclasses.replace(motion(1), axis_names=("jawLeft", "own1", "neckLength", "mouthLeft"))
    layout = facial_layout(sequence)
    codes = facial_codes(sequence, layout)
    assert layout.names[:3] == ("jawLeft", "own1", "mouthLeft") and layout.shared[:3] == (True, False, True)
    assert codes.shape == (12, 3 + 3 + 2 + 2 + 2)
    same = with_facial_codes(sequence, layout, codes)
    for name in ("expression", "joint_rotations", "eyelids"):
        np.testing.assert_array_equal(getattr(same, name), getattr(sequence, name))
    moved = with_facial_codes(sequence, layout, codes + 1)
    np.testing.assert_array_equal(moved.expression[:, 2], sequence.expression[:, 2])  # the neck's length
    np.testing.assert_array_equal(moved.joint_rotations[:, 2], sequence.joint_rotations[:, 2] + 1)  # the jaw
    np.testing.assert_array_equal(moved.joint_rotations[:, 3, 2], sequence.joint_rotations[:, 3, 2])  # an eye's roll
    np.testing.assert_array_equal(moved.joint_rotations[:, :2], sequence.joint_rotations[:, :2])
    assert layout.zero_is_rest and not facial_layout(motion(1)).zero_is_rest


def test_unnamed_axes_are_shared_by_one_version_only() -> None:
    first, second = (facial_layout(motion(1)), facial_layout(dataclasses.replace(motion(1), head_version="toy-2")))
    assert first.names[:4] != second.names[:4] and first.names[4:] == second.names[4:]
