"""Layouts of others' trainers that a capture can be written in; packages offer them as entry points.

This package reads captures but does not make them: who can write one in another layout registers a function
(capture, folder) → report under the group below, and is imported only when its layout is asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from ggavatar.data.capture import Capture
from ggavatar.errors import InputError
from ggavatar.formats.output_folder import appearing_folder

GROUP = "ggavatar.capture_formats"

Writer = Callable[[Capture, Path], Mapping[str, Any]]


def capture_formats() -> list[str]:
    """Names of the layouts that are installed."""
    return sorted(point.name for point in entry_points(group=GROUP))


def export_capture(capture: Capture, kind: str, folder: Path, overwrite: bool) -> Mapping[str, Any]:
    """Write a capture in another trainer's layout; the folder appears whole or not at all.

    Args:
        capture: What to write.
        kind: One of `capture_formats`.
        folder: Where to write.
        overwrite: Replace what an earlier export wrote.

    Returns:
        The writer's report: `frames`, and under `notes` what could not be represented.

    Raises:
        InputError: No such layout, the capture cannot be written in it, or the output must not be replaced.
    """
    points = {point.name: point for point in entry_points(group=GROUP)}
    if kind not in points:
        raise InputError(f"expected a capture's layout of {', '.join(points) or 'none installed'}, found {kind!r}")
    write: Writer = points[kind].load()
    with appearing_folder(folder, overwrite) as unfinished:
        return write(capture, unfinished)
