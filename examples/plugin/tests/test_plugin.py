"""The package's own tests: closed forms, and what is written is read back. Run with `pytest` where it is installed."""

from __future__ import annotations

import dataclasses
import io
from pathlib import Path

import numpy as np
import pytest
from ggavatar_example import edge_error, head_angles, painted_mesh, xyz

from ggavatar.errors import InputError
from ggavatar.formats.splats.stored_gaussians import StoredGaussians


def test_edges_of_a_ramp_against_a_flat_image() -> None:
    """Sobel of a ramp of k levels per pixel is 8 k: inside the borders the error is k / 255."""
    ramp = np.repeat(np.arange(0, 64, 2, dtype=np.uint8)[None, :, None], 32, axis=0).repeat(3, axis=2)
    inside = np.zeros((32, 32))
    inside[8:-8, 8:-8] = 1
    found = edge_error.measure(ramp, np.zeros_like(ramp), inside)
    assert found == pytest.approx(2 / 255, rel=1e-9)
    assert edge_error.measure(ramp, ramp, None) == 0 and edge_error.measure(ramp, ramp, inside * 0) is None


def test_angles_are_read_as_poses(tmp_path: Path) -> None:
    lines = [",".join(head_angles.COLUMNS), "4,640,480,900,0.1,0,0.7,90,0,0,0.2", "6,640,480,900,0,0,0.7,0,0,0,0"]
    path = tmp_path / "take.csv"
    path.write_text("\n".join(lines))
    assert head_angles.recognizes(path) and not head_angles.recognizes(tmp_path)
    record = head_angles.read(path)
    assert record.numbers.tolist() == [4, 6] and (record.width, record.height) == (640, 480)
    np.testing.assert_allclose(record.world_to_camera[1, :3, :3], np.diag([1, -1, -1]), atol=1e-12)
    # A quarter turn of the head to its left: its nose (+z) points along the camera's +x.
    np.testing.assert_allclose(record.world_to_camera[0, :3, :3] @ [0, 0, 1], [1, 0, 0], atol=1e-12)
    assert record.joint_rotations[0, 2, 0] == 0.2


@pytest.mark.parametrize("line", ["", "3,640,480,900,0,0,0.7,x,0,0,0"])
def test_bad_files_are_refused_by_name(line: str, tmp_path: Path) -> None:
    path = tmp_path / "take.csv"
    path.write_text(",".join(head_angles.COLUMNS) + "\n" + line)
    with pytest.raises(InputError, match=r"take\.csv: expected"):
        head_angles.read(path)


def test_a_point_and_its_color() -> None:
    zeros = np.zeros((1, 3), np.float32)
    rows = StoredGaussians(
        np.array([[1, 2, 3]], np.float32),
        np.array([[0.5 / xyz.SH_C0, 0, -9]], np.float32),
        np.zeros((1, 0, 3), np.float32),
        np.zeros(1, np.float32),
        zeros,
        np.array([[1, 0, 0, 0]], np.float32),
    )
    stream = io.BytesIO()
    xyz.write(stream, rows)
    assert stream.getvalue() == b"1.000000 2.000000 3.000000 255 128 0\n"


def test_the_method_has_a_frozen_configuration() -> None:
    assert dataclasses.fields(painted_mesh.Config)[0].default == 0.2
    with pytest.raises(dataclasses.FrozenInstanceError):
        painted_mesh.Config().dssim_share = 0.3  # type: ignore[misc]
