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
    notes: tuple[str, ...] = ()
    extra: Mapping[str, Any] = field(default_factory=dict)


def stacked(source: object, rows: Sequence[np.ndarray], what: str) -> np.ndarray:
    """One row per frame as one array; `InputError` naming the source if the rows differ in length."""
    if len({row.shape for row in rows}) != 1:
        raise InputError(f"{source}: expected the same number of {what} in all frames; track the video in a single run")
    return np.stack(rows)


def require_finite(source: object, record: TrackingRecord) -> TrackingRecord:
    """The record, unchanged; `InputError` naming the source if a number is NaN, infinite or above 10⁶ in magnitude."""
    for item in dataclasses.fields(record):
        value = getattr(record, item.name)
        if isinstance(value, np.ndarray) and value.dtype.kind == "f":
            bad = ~(np.abs(value) < 1e6)
            if bad.any():
                first = int(np.argwhere(bad)[0][0])
                where = f"frame {int(record.numbers[first])}" if item.name != "shape" else "the identity"
                raise InputError(
                    f"{source}: {item.name} of {where} is NaN, infinite or above 10⁶ in magnitude; track the video "
                    "again or leave the frame out"
                )
    return record
