"""The tracking in an avatar file: drives, cameras and expression scores of the frames, and nothing that shows them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ggavatar.data.capture import Capture, Tracking
from ggavatar.data.capture_schema import check_tracking
from ggavatar.data.capture_without_images import CaptureWithoutImages
from ggavatar.data.splits import Split
from ggavatar.errors import InputError
from ggavatar.formats.avatar_file.container import SCORES
from ggavatar.text.names import clean_name

STORED = (
    *("intrinsics", "world_to_camera", "expression", "joint_rotations", "eyelids", "translation"),
    "torso_to_camera",
)
"""Arrays of the tracking that move an avatar; landmarks and identity coefficients stay with the capture."""
MAX_FRAMES, MAX_SIDE, MAX_PIXELS = 1_000_000, 16384, 4096 * 4096
"""What a file may ask for, whatever its own size; pictures of `MAX_PIXELS` are rendered in less than 1 GB."""


def tracking_tensors(capture: Capture, scores: np.ndarray | None) -> dict[str, Tensor]:
    """The tracking of all frames as tensors in the types of the capture, and the scores if they were measured."""
    arrays = {name: value for name, value in capture.tracking.arrays().items() if name in STORED}
    tensors = {name: torch.from_numpy(np.ascontiguousarray(value)) for name, value in arrays.items()}
    return tensors | ({} if scores is None else {SCORES: torch.from_numpy(scores)})


def clip_description(capture: Capture, split: Split) -> dict[str, Any]:
    """What the frames are: their numbers, size and rate, and which of them are for training and for tests."""
    return {
        "subject": capture.subject,
        "width": capture.width,
        "height": capture.height,
        "fps": capture.fps,
        "frames": list(capture.frames),
        "train": list(split.train),
        "test": list(split.test),
    }


def stored_capture(
    path: Path, clip: Any, tensors: Mapping[str, Tensor], head_version: str, sizes: tuple[int, int]
) -> tuple[CaptureWithoutImages, Split]:
    """The capture and split of an avatar file, checked as `Capture.open` checks a folder.

    Args:
        path: The file.
        clip: As `clip_description` gives it.
        tensors: As `tracking_tensors` gives them.
        head_version: Of the head in the file.
        sizes: Number of expression coefficients and of joints of that head.

    Raises:
        InputError: Something is missing or does not fit.
    """
    if not isinstance(clip, dict):
        raise InputError(f"{path}: expected 'clip' to be an object; export the avatar again")
    frames, train, test = (_numbers(path, clip, name) for name in ("frames", "train", "test"))
    known = set(frames)
    if not frames or not set(train) | set(test) <= known or set(train) & set(test):
        raise InputError(f"{path}: expected training and test frames among 'frames'; export the avatar again")
    count, (expressions, joints) = len(frames), sizes
    shapes = {
        "intrinsics": (count, 3, 3),
        "world_to_camera": (count, 4, 4),
        "expression": (count, expressions),
        "joint_rotations": (count, joints, 3),
        "eyelids": (count, 2),
        "translation": (count, 3),
        "torso_to_camera": (count, 4, 4),
        SCORES: (count, 52),
    }
    arrays = {name: value.numpy() for name, value in tensors.items() if name in shapes}
    for name, shape in shapes.items():
        optional = name in ("torso_to_camera", SCORES)
        found = arrays[name].shape if name in arrays else None
        if found != shape and not (optional and found is None):
            raise InputError(f"{path}: expected {name!r} of shape {shape}, found {found}; export the avatar again")
    scores, (width, height) = arrays.pop(SCORES, None), _size(path, clip)
    tracking = Tracking(**arrays)
    check_tracking(path, tracking.arrays(), count)
    return CaptureWithoutImages(
        folder=path,
        subject=clean_name(str(clip.get("subject", ""))) or "unnamed",
        width=width,
        height=height,
        fps=_rate(path, clip),
        frames=frames,
        splits={},
        tracking=tracking,
        head_version=head_version,
        scores=scores,
    ), Split(train, test)


def _numbers(path: Path, clip: Mapping[str, Any], name: str) -> tuple[int, ...]:
    value = clip.get(name)
    numbers = value if isinstance(value, list) and len(value) <= MAX_FRAMES else [None]
    whole = all(type(number) is int and 0 <= number < 1 << 31 for number in numbers)
    if not whole or sorted(set(numbers)) != numbers:
        raise InputError(f"{path}: expected {name!r} to list ascending frame numbers; export the avatar again")
    return tuple(numbers)


def _size(path: Path, clip: Mapping[str, Any]) -> tuple[int, int]:
    """Width and height, px."""
    width, height = (_whole(path, clip, name) for name in ("width", "height"))
    if width * height > MAX_PIXELS:
        raise InputError(f"{path}: expected at most {MAX_PIXELS} px in a picture, found {width}×{height}")
    return width, height


def _whole(path: Path, clip: Mapping[str, Any], name: str) -> int:
    value = clip.get(name)
    if type(value) is not int or not 0 < value <= MAX_SIDE:
        raise InputError(f"{path}: expected {name!r} of 1 to {MAX_SIDE} px, found {value!r:.40}")
    return value


def _rate(path: Path, clip: Mapping[str, Any]) -> float:
    value = clip.get("fps")
    if not isinstance(value, int | float) or isinstance(value, bool) or not 0 < value <= 100_000:
        raise InputError(f"{path}: expected 'fps' to be a positive number, found {value!r:.40}")
    return float(value)
