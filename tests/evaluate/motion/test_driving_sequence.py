"""Files that drive an avatar, as driving sequences. Reference: the arrays that were written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from evaluate.motion.driving_sequence import driving_sequence_of, driving_sequence_of_run, read_driving_sequence
from evaluate.motion.retarget import in_version_of
from ggavatar.errors import InputError
from ggavatar.formats.flame_parameters import FlameParameters, write_flame_parameters
from ggavatar.head.procedural.expression import expression_names
from tests.support.toy_run import toy_run


def test_a_run_has_the_sequence_of_its_capture(tmp_path: Path) -> None:
    run = toy_run(tmp_path)
    own, captured = driving_sequence_of_run(run), driving_sequence_of(run.capture)
    np.testing.assert_array_equal(own.expression, captured.expression)
    assert (own.joint_names, own.axis_names, own.fps) == (captured.joint_names, captured.axis_names, captured.fps)


def test_known_axes_of_a_file_have_their_names(tmp_path: Path) -> None:
    names = expression_names()
    np.savez(tmp_path / "p.npz", expression=np.zeros((2, len(names))), version="procedural-1")
    assert read_driving_sequence(tmp_path / "p.npz").axis_names == names
    np.savez(tmp_path / "f.npz", expression=np.zeros((2, 50)), version="flame2020")
    assert read_driving_sequence(tmp_path / "f.npz").axis_names == ()


def test_flame_param_drives_an_avatar_on_any_flame(tmp_path: Path) -> None:
    """GaussianAvatars' file does not say its version; zeros that pad it to 100 coefficients are dropped."""
    random = np.random.default_rng(0)
    expression, joints = random.normal(size=(4, 3)), 0.1 * random.normal(size=(4, 5, 3))
    parameters = FlameParameters(
        shape=np.zeros(3, np.float32), expression=expression.astype(np.float32),
        joint_rotations=joints.astype(np.float32), translation=np.zeros((4, 3), np.float32),
    )  # fmt: skip
    write_flame_parameters(tmp_path / "flame_param.npz", parameters, 5023)
    read = read_driving_sequence(tmp_path / "flame_param.npz")
    assert (read.head_version, read.expression.shape) == ("flame", (4, 100)) and "jaw" in read.joint_names
    np.testing.assert_allclose(read.joint_rotations, joints, atol=1e-6)
    target = driving_sequence_of_run(toy_run(tmp_path / "toy"))
    target = type(target)(**{**vars(target), "head_version": "flame2023"})
    fitted = in_version_of(read, target)
    assert fitted.head_version == "flame2023" and fitted.expression.shape == (4, target.expression.shape[1])
    np.testing.assert_allclose(fitted.expression, expression, atol=1e-6)
    other = type(target)(**{**vars(target), "head_version": "toy-1"})
    assert in_version_of(read, other) is read


def test_other_files_are_refused_with_the_page_that_lists_them(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("hello")
    with pytest.raises(InputError, match=r"docs/driving\.md"):
        read_driving_sequence(tmp_path / "a.txt")


def test_a_name_of_60_000_characters_does_not_fill_the_screen(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", **{"x" * 60_000: np.zeros(1)})
    with pytest.raises(InputError, match=r"a\.npz") as refused:
        read_driving_sequence(tmp_path / "a.npz")
    assert len(str(refused.value)) < 1000
