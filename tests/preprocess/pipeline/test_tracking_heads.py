"""The head model of an imported tracking: versions that belong together, and joints by name where the head lacks some.

Reference: FLAME's joint order root, neck, jaw, left eye, right eye; GNM has no jaw.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from ggavatar.errors import InputError
from ggavatar.io.npz import write_npz
from preprocess.options import PrepOptions
from preprocess.pipeline.tracking_stage import _head, _joints
from tests.ggavatar.head.test_other_head_models import gnm_arrays
from tests.support.synthetic_clip import moving_record

GNM = ("root", "neck", "left_eye", "right_eye")


def options(tmp_path: Path, head: Path) -> PrepOptions:
    return PrepOptions(tmp_path, tmp_path / "out", tracking=tmp_path, head_model=head)


def test_joints_by_name() -> None:
    record = moving_record(3)
    joints = np.random.default_rng(0).normal(0, 0.1, (3, 5, 3))
    joints[:, 2] = 0
    found = _joints(dataclasses.replace(record, joint_rotations=joints), GNM)
    np.testing.assert_array_equal(found, joints[:, [0, 1, 3, 4]])
    with pytest.raises(InputError, match="the joint 'jaw'"):
        _joints(record, GNM)


def test_joints_by_position() -> None:
    """Heads with all five, and others after them, as before."""
    record = moving_record(3)
    found = _joints(record, ("root", "neck", "jaw", "left_eye", "right_eye", "cervical", "torso"))
    np.testing.assert_array_equal(found[:, :5], record.joint_rotations)
    assert found.shape == (3, 7, 3) and not found[:, 5:].any()


def test_coefficients_of_another_model_are_refused(tmp_path: Path) -> None:
    write_npz(tmp_path / "head.npz", gnm_arrays())
    record = dataclasses.replace(moving_record(3), shape=np.ones(300))
    with pytest.raises(InputError, match=r"expected flame2020.* found another head model"):
        _head(options(tmp_path, tmp_path / "head.npz"), record)
    with pytest.raises(InputError, match=r"expected gnm-head-2.0.* found gnm-head-3.0"):
        _head(options(tmp_path, tmp_path / "head.npz"), dataclasses.replace(record, shape=None, version="gnm-head-2.0"))


def test_coefficients_of_the_same_model_are_taken(tmp_path: Path) -> None:
    write_npz(tmp_path / "head.npz", gnm_arrays())
    record = dataclasses.replace(moving_record(3), shape=np.ones(6), version="gnm-head-3.0")
    head, notes = _head(options(tmp_path, tmp_path / "head.npz"), record)
    assert head.expression_basis.shape[2] == 4 and notes == []
