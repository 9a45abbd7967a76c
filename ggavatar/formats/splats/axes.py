"""Axes of files of Gaussians: most formats say nothing of them."""

from __future__ import annotations

import dataclasses
from typing import Literal

from ggavatar.formats.splats.stored_gaussians import StoredGaussians, rotate_180_about_x

Axes = Literal["auto", "world", "viewer"]
VIEWER_AXES_NOTE = (
    "it is read in the axes of viewers (x right, y down, z away); if it is upside down, pass --axes world"
)


def in_our_axes(rows: StoredGaussians, axes: Axes, is_for_viewers: bool) -> StoredGaussians:
    """Gaussians of a format that says nothing of its axes; those for viewers only are assumed to be in theirs."""
    if axes == "auto" and is_for_viewers:
        rows = dataclasses.replace(rows, notes=(*rows.notes, VIEWER_AXES_NOTE))
    return rotate_180_about_x(rows) if axes == "viewer" or (axes == "auto" and is_for_viewers) else rows
