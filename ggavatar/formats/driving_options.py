"""Flags of `--drive`, the same for every command that takes it. Does not import torch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from tyro.conf import arg


@dataclass(frozen=True)
class DrivingOptions:
    """How a performance is carried over to an avatar (docs/driving.md)."""

    transfer: Literal["matched", "relative", "absolute"] = "matched"
    """With --drive: show what the driver's face shows, by expression scores and shared axes; or add its changes of
    coefficients from its neutral frame to the avatar's; or copy its coefficients."""
    pose: Literal["relative", "absolute", "still"] = "relative"
    """With --drive: the same for the head's pose relative to the camera; still keeps that of the avatar's neutral
    frame."""
    smooth: Literal["none", "one-euro", "savgol"] = "savgol"
    """With --drive: temporal filter of the driving sequence."""
    limit: float = 3.0
    """With --drive: how far a coefficient may leave the range seen in training, as a fraction of that range; negative:
    no limit."""
    driver_neutral: int | None = None
    """With --drive: frame number that shows the driver at rest; by default rest is computed from all frames."""
    target_neutral: int | None = None
    """Frame number that shows the avatar's subject at rest, also used for an orbit; computed by default."""
    force_basis: bool = False
    """With --drive: accept another number of coefficients or another version of the same family of bases."""


@dataclass(frozen=True)
class RenderDrivingOptions(DrivingOptions):
    """The same for ggavatar-render, where --neutral has no other meaning."""

    driver_neutral: Annotated[int | None, arg(aliases=["--neutral"])] = None
    """With --drive: frame number that shows the driver at rest; by default rest is computed from all frames."""
