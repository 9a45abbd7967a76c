"""The tracking record: another tracker's output in our conventions, not yet paired with the frames of a video."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ggavatar.errors import InputError

FLAME_JOINTS = 5

MAX_MAGNITUDE = 1e6
"""No length, angle, coefficient or focal length of a portrait reaches this."""

MAX_BAD_SHARE = 0.5
"""Largest share of a clip's frames that may be left out: beyond it, something else is wrong than single frames."""


@dataclass(frozen=True)
class TrackingRecord:
    """Cameras and FLAME parameters of T frames in the conventions of docs/conventions.md.

    Attributes:
        numbers: Frame numbers as in the files, ascending; the first number differs between tools.
        width: Width of the images that the intrinsics belong to, px.
        height: Height of the same images, px.
        intrinsics: Camera matrices, px.
        world_to_camera: Rigid transforms in OpenCV axes, m.
        expression: FLAME's expression coefficients.
        joint_rotations: Axis-angle of root, neck, jaw, left eye and right eye, rad.
        eyelids: Closing of the left and right lid (metrical-tracker, SMIRK), else zeros.
        translation: Translation of the head, m.
        shape: Identity coefficients, if the format has them.
        version: FLAME version that the coefficients belong to by the tool's default; None if they are not FLAME's.
        camera_is_assumed: Whether focal length and distance only stand for a camera that the tool does not know, as for
            weak perspective; images agree, distances are not metric.
        notes: What could not be represented or was assumed, for the report.
        extra: Further arrays of the format, such as VHAP's "static_offset".
    """

    numbers: Int[np.ndarray, " T"]
    width: int
    height: int
    intrinsics: Float[np.ndarray, "T 3 3"]
    world_to_camera: Float[np.ndarray, "T 4 4"]
    expression: Float[np.ndarray, "T E"]
    joint_rotations: Float[np.ndarray, "T 5 3"]
    eyelids: Float[np.ndarray, "T 2"]
    translation: Float[np.ndarray, "T 3"]
    shape: Float[np.ndarray, " S"] | None = None
    version: str | None = "flame2020"
    camera_is_assumed: bool = False
    notes: tuple[str, ...] = ()
    extra: Mapping[str, Any] = field(default_factory=dict)

    def rows(self, chosen: np.ndarray) -> TrackingRecord:
        """The record of some of its frames, chosen by a mask or by rows."""
        names = ("intrinsics", "world_to_camera", "expression", "joint_rotations", "eyelids", "translation", "numbers")
        return dataclasses.replace(self, **{name: getattr(self, name)[chosen] for name in names})


def stacked(source: object, rows: Sequence[np.ndarray], what: str) -> np.ndarray:
    """One row per frame as one array; `InputError` naming the source if the rows differ in length."""
    if len({row.shape for row in rows}) != 1:
        raise InputError(f"{source}: expected the same number of {what} in all frames; track the video in a single run")
    return np.stack(rows)


def without_bad_frames(source: object, record: TrackingRecord) -> TrackingRecord:
    """The record without the frames that hold a number that is NaN, infinite or above 10⁶ in magnitude, and a note.

    Raises:
        InputError: More than half of the frames do, or the identity does; the message names the source.
    """
    bad = np.zeros(len(record.numbers), dtype=bool)
    what = ""
    for item in dataclasses.fields(record):
        value = getattr(record, item.name)
        if isinstance(value, np.ndarray) and value.dtype.kind == "f":
            wrong = ~(np.abs(value) < MAX_MAGNITUDE)
            if item.name == "shape":
                _require_good_identity(source, wrong)
                continue
            rows = wrong.reshape(len(value), -1).any(axis=1)
            what = what or (item.name if rows.any() else "")
            bad |= rows
    if not bad.any():
        return record
    numbers = record.numbers[bad].tolist()
    cause = f"{what} of frame {numbers[0]} is NaN, infinite or above 10⁶ in magnitude"
    if bad.sum() > MAX_BAD_SHARE * len(bad):
        raise InputError(f"{source}: {cause}, and so in {bad.sum()} of {len(bad)} frames; track the video again")
    return dataclasses.replace(record.rows(~bad), notes=(*record.notes, f"{left_out_text(numbers, len(bad))}: {cause}"))


def _require_good_identity(source: object, wrong: np.ndarray) -> None:
    if wrong.any():
        raise InputError(f"{source}: the identity is NaN, infinite or above 10⁶ in magnitude; track the video again")


def left_out_text(numbers: Sequence[int], total: int) -> str:
    """A phrase such as "2 of 24 frames of the tracking (3, 7) cannot be used and are left out"."""
    shown = ", ".join(str(number) for number in sorted(numbers)[:5]) + (", …" if len(numbers) > 5 else "")
    if len(numbers) == 1:
        return f"frame {shown} of the tracking cannot be used and is left out"
    return f"{len(numbers)} of {total} frames of the tracking ({shown}) cannot be used and are left out"
