"""Export of a run as an avatar file: all that the avatar needs to be opened like the run, and no photograph."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from ggavatar import __version__
from ggavatar.data.expression_scores import measured_scores
from ggavatar.errors import InputError
from ggavatar.formats.avatar_file.container import Container, write_container
from ggavatar.formats.avatar_file.tracking import MAX_PIXELS, clip_description, tracking_tensors
from ggavatar.formats.drives import neutral_drive
from ggavatar.formats.licensed_heads import check_license, is_licensed
from ggavatar.formats.output_folder import check_output_file, output_file
from ggavatar.head.axis_names import axis_names
from ggavatar.head.files import head_arrays
from ggavatar.io.dataclass_json import to_plain
from ggavatar.landmarks.blendshapes import NAMES
from ggavatar.pretrained.resolve import ModelFinder
from ggavatar.training.run_folder import Run

CONSENT = (
    "This file is the likeness of a person, movable by whoever has it. Use it only as that person has agreed to. It "
    "holds no photograph, but how the person's head and face moved in the video."
)
LICENSE = {
    False: "The head model is not licensed by others; the avatar belongs to those who made it and to whom it shows.",
    True: "The head model in this file belongs to others (FLAME: https://flame.is.tue.mpg.de); its license decides "
    "whether the file may be passed on.",
}
RANGE = (0.01, 0.99)
"""Quantiles of the training frames between which an axis is called its range."""
UNMEASURED = (
    "the landmark network is not here, so that no expression scores are in the file: only drivers with the same "
    "expression axes can drive it; ggavatar-models --fetch face_landmarker, then export again"
)


class AvatarFile(NamedTuple):
    """What was written.

    Attributes:
        path: The file.
        bytes: Its size.
        notes: What its user must know.
    """

    path: Path
    bytes: int
    notes: tuple[str, ...]


def export_avatar_file(
    run: Run, path: Path, overwrite: bool, include_head_model: bool = False, finder: ModelFinder | None = None
) -> AvatarFile:
    """Write a run as one file.

    The avatar is its method's `state_dict`, in which a method keeps whatever decides how it looks (`core.Avatar`): a
    method needs nothing else to be exported.

    Args:
        run: The avatar.
        path: The file to write.
        overwrite: Replace an earlier file.
        include_head_model: The user may pass on a licensed head model.
        finder: Finds the landmark network, by which the faces of the training frames are measured for later drivers.

    Raises:
        InputError: The head is licensed, the file exists, or the pictures are larger than readers accept.
    """
    check_output_file(path, overwrite)
    check_license(run.folder, run.head, "file", include_head_model)
    width, height = run.capture.width, run.capture.height
    if width * height > MAX_PIXELS:
        raise InputError(
            f"{run.folder}: an avatar file shows pictures of at most {MAX_PIXELS} px, found {width}×{height}; prepare "
            "a smaller capture (ggavatar-prep --size)"
        )
    scores = _scores(run, finder or ModelFinder())
    content = Container(
        _description(run),
        {
            "head": _head_tensors(run),
            "avatar": dict(run.avatar.state_dict()),
            "tracking": tracking_tensors(run.capture, scores),
        },
    )
    with output_file(path, overwrite):
        size = write_container(path, content)
    return AvatarFile(path, size, (CONSENT, *([] if scores is not None else [UNMEASURED])))


def _head_tensors(run: Run) -> dict[str, Tensor]:
    """The arrays of the head that are numbers; its names are in the description."""
    arrays = {name: value for name, value in head_arrays(run.head).items() if value.dtype.kind != "U"}
    return {name: torch.from_numpy(np.ascontiguousarray(value)) for name, value in arrays.items()}


def _scores(run: Run, finder: ModelFinder) -> np.ndarray | None:
    """Expression scores of the training frames, NaN elsewhere; they are what drivers with other heads are matched to.

    An avatar that was opened from a file keeps those of the file.
    """
    found = measured_scores(run.capture, run.split.train, finder)
    if found is None:
        return None
    scores = np.full((len(run.capture.frames), len(NAMES)), np.nan, np.float32)
    scores[[run.capture.row(number) for number in run.split.train]] = found
    return scores


def _description(run: Run) -> dict[str, Any]:
    head = run.head
    # The capture's place on the exporting machine is nobody's business.
    config = to_plain(dataclasses.replace(run.config, capture="", device="cpu", backend="auto"))
    return {
        "created_by": {"ggavatar": __version__, "run_sha256": run.sha256},
        "method": run.method,
        "step": run.step,
        "config": config,
        "head": {
            "version": head.version,
            "joint_names": list(head.joint_names),
            "expression_names": list(head.expression_names),
        },
        "clip": clip_description(run.capture, run.split),
        "axes": _axes(run),
        "neutral": _neutral(run),
        "notes": {"consent": CONSENT, "license": LICENSE[is_licensed(head)]},
    }


def _axes(run: Run) -> list[dict[str, Any]]:
    """Name and range in training of every expression coefficient: for readers that do not need the tracking."""
    rows = [run.capture.row(number) for number in run.split.train] or [0]
    low, high = np.quantile(run.capture.tracking.expression[rows].astype(np.float64), RANGE, axis=0)
    return [
        {"name": name, "low": round(float(least), 6), "high": round(float(most), 6)}
        for name, least, most in zip(axis_names(run.head), low, high, strict=True)
    ]


def _neutral(run: Run) -> dict[str, Any]:
    """The neutral drive: what is not named is zero; the head is in its mean pose of the training frames."""
    drive = neutral_drive(run, run.head).drive
    return {"head_to_camera": [round(value, 7) for value in drive.head_to_camera.flatten().tolist()]}
