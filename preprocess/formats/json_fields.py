"""Checked fields of other tools' JSON files, and conversions of the cameras in them.

Written by hand, not with pydantic or msgspec: the checks are array shapes, finite numbers and paths that stay in their
folder, which neither library offers; both would be an added dependency.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from jaxtyping import Float

from ggavatar.errors import InputError
from ggavatar.io.frame_names import FrameNumbers, frame_numbers

MAX_FRAMES = 200_000
"""More frames than any video that is tracked."""


def frame_list(path: Path, data: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """The objects under "frames"; `InputError` if there are none or too many."""
    frames = data.get("frames")
    if not isinstance(frames, list) or not frames or len(frames) > MAX_FRAMES:
        raise InputError(
            f'{path}: expected "frames" to be a list of 1 to {MAX_FRAMES} frames; export the tracking again'
        )
    if not all(isinstance(frame, dict) for frame in frames):
        raise InputError(f'{path}: expected every entry of "frames" to be an object')
    return frames


def frames_by_number(path: Path, data: Mapping[str, Any]) -> tuple[dict[int, Mapping[str, Any]], tuple[str, ...]]:
    """The objects under "frames" by the ascending number in their "file_path", and notes on what was assumed.

    Raises:
        InputError: As in `frame_list` and `listed_numbers`.
    """
    frames = frame_list(path, data)
    listed = listed_numbers(path, [frame.get("file_path") for frame in frames])
    return listed.by_number(frames), listed.notes


def finite_number(path: Path, data: Mapping[str, Any], key: str) -> float:
    """The finite number under `key`; `InputError` naming the file if it is anything else."""
    value = data.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e9:
        raise InputError(f"{path}: expected {key!r} to be a number, found {value!r:.60}")
    return float(value)


def image_size(path: Path, data: Mapping[str, Any]) -> tuple[int, int]:
    """Width and height in px from "w" and "h"; `InputError` if they are no image size."""
    width, height = (round(finite_number(path, data, key)) for key in ("w", "h"))
    if not (1 <= width <= 16384 and 1 <= height <= 16384):
        raise InputError(f'{path}: expected "w" and "h" from 1 to 16384 px, found {width}×{height}')
    return width, height


def number_array(path: Path, value: object, shape: Sequence[int | None], what: str) -> Float[np.ndarray, "..."]:
    """Nested lists as an array of the given shape, in which None fits any size.

    Raises:
        InputError: Not numbers, not finite, or of another shape; the message names the file and `what`.
    """
    try:
        found = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{path}: expected {what} to be numbers of shape {_shape_text(shape)}") from error
    fits = found.ndim == len(shape) and all(
        want in (None, size) for want, size in zip(shape, found.shape, strict=False)
    )
    if not fits or not np.isfinite(found).all():
        raise InputError(
            f"{path}: expected {what} to be finite numbers of shape {_shape_text(shape)}, found shape {found.shape}"
        )
    return found


def _shape_text(shape: Sequence[int | None]) -> str:
    return "(" + ", ".join("any" if size is None else str(size) for size in shape) + ")"


def listed_numbers(path: Path, names: Sequence[object]) -> FrameNumbers:
    """The frame numbers in listed names such as "./image/17" or "images/00017.png", by the rule for all names.

    Raises:
        InputError: A name has no number, or it cannot be told which number counts the frames.
    """
    stems = [PurePosixPath(name).stem if isinstance(name, str) else "" for name in names]
    without = next((name for name, stem in zip(names, stems, strict=True) if not re.search(r"\d", stem)), None)
    if any(not re.search(r"\d", stem) for stem in stems):
        raise InputError(f"{path}: expected a file name with the frame number in it, found {without!r:.60}")
    return frame_numbers(stems, path)


def pose_from_opengl(matrix: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    """World-to-camera in OpenCV axes from camera-to-world in OpenGL axes (x right, y up, z backwards)."""
    return invert_pose(matrix @ np.diag([1.0, -1.0, -1.0, 1.0]))


def pose_to_opengl(pose: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    """Camera-to-world in OpenGL axes from world-to-camera in OpenCV axes; the inverse of `pose_from_opengl`."""
    return invert_pose(pose) @ np.diag([1.0, -1.0, -1.0, 1.0])


def invert_pose(matrix: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    """The inverse of a rigid transform."""
    result = np.eye(4)
    result[:3, :3] = matrix[:3, :3].T
    result[:3, 3] = -matrix[:3, :3].T @ matrix[:3, 3]
    return result


def camera_matrix(focal_x: float, focal_y: float, center_x: float, center_y: float) -> Float[np.ndarray, "3 3"]:
    """The intrinsics matrix of focal lengths and principal point, px."""
    return np.array([[focal_x, 0, center_x], [0, focal_y, center_y], [0, 0, 1.0]])
