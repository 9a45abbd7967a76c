"""Dataset layouts of other trainers that a capture can be exported to, registered as entry points.

A package that can write a layout registers a function (capture, folder) → report in the group below; it is imported
only when its layout is requested.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from ggavatar.data.capture import Capture
from ggavatar.errors import InputError
from ggavatar.formats.output_folder import atomic_folder

ENTRY_POINT_GROUP = "ggavatar.capture_formats"

Writer = Callable[[Capture, Path], Mapping[str, Any]]


def capture_formats() -> list[str]:
    """Names of the installed layouts."""
    return sorted(point.name for point in entry_points(group=ENTRY_POINT_GROUP))


def export_capture(capture: Capture, kind: str, folder: Path, overwrite: bool) -> Mapping[str, Any]:
    """Write a capture in another trainer's layout; the folder appears complete or not at all.

    Args:
        capture: The capture.
        kind: One of `capture_formats`.
        folder: The folder to write.
        overwrite: Replace an earlier export.

    Returns:
        The writer's report: `frames`, their number, and `notes`, on what could not be represented.

    Raises:
        InputError: There is no such layout, the capture cannot be written in it, or the output must not be replaced.
    """
    points = {point.name: point for point in entry_points(group=ENTRY_POINT_GROUP)}
    if kind not in points:
        installed = ", ".join(sorted(points)) or "(none is installed)"
        raise InputError(f"expected one of the layouts {installed}, found {kind!r}")
    write: Writer = points[kind].load()
    with atomic_folder(folder, overwrite) as temporary:
        return write(capture, temporary)
