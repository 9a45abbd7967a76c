"""Tracking as another tool wrote it, in our conventions but not yet paired with the frames of a video."""

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
        numbers: Frame numbers as the files count them, ascending; where they start differs from tool to tool.
        width: Of the image that the intrinsics belong to, px.
        height: Of the same image, px.
        intrinsics: px.
        world_to_camera: Rigid, meters, OpenCV axes.
        expression: FLAME's expression coefficients.
        joint_rotations: Axis-angle of root, neck, jaw, left eye, right eye, rad.
        eyelids: Closing of the lids (metrical-tracker, SMIRK), else zeros.
        translation: m.
        shape: Identity coefficients, if the format has them.
        version: FLAME version the coefficients belong to by the tool's default; None if they are not FLAME's.
        notes: What could not be represented or was assumed, for the report.
        extra: Arrays a writer may need for an exact round trip.
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

    def rows(self, chosen: np.ndarray) -> TrackingRecord:
        """The tracking of some rows."""
        names = ("numbers", "intrinsics", "world_to_camera", "expression", "joint_rotations", "eyelids", "translation")
        return dataclasses.replace(self, **{name: getattr(self, name)[chosen] for name in names})


def stacked(source: object, rows: Sequence[np.ndarray], what: str) -> np.ndarray:
    """Rows of all frames as one array; `InputError` naming the source if frames have different numbers of them."""
    if len({row.shape for row in rows}) != 1:
        raise InputError(f"{source}: frames have different numbers of {what}; track the video in one go")
    return np.stack(rows)


def require_finite(source: object, record: TrackingRecord) -> TrackingRecord:
    """The record itself; `InputError` naming the source if a number is NaN, infinite or absurdly large."""
    for item in dataclasses.fields(record):
        value = getattr(record, item.name)
        if isinstance(value, np.ndarray) and value.dtype.kind == "f":
            bad = ~(np.abs(value) < 1e6)
            if bad.any():
                first = int(np.argwhere(bad)[0][0])
                where = f"frame {int(record.numbers[first])}" if item.name != "shape" else "the identity"
                raise InputError(
                    f"{source}: {item.name} of {where} is NaN, infinite or absurdly large; track the video again "
                    "or drop it"
                )
    return record
