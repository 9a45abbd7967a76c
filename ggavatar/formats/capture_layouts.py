"""Dataset layouts of other trainers that a capture can be exported to, registered as entry points.

A package that can write a layout registers a function (capture, folder) → report (`ggavatar.plugins`); it is imported
only when its layout is requested.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from ggavatar.data.capture import Capture
from ggavatar.errors import InputError, nearest
from ggavatar.formats.output_folder import atomic_folder
from ggavatar.plugins.entry_points import CAPTURE_FORMATS, guarded, listed, own_entry_points

Writer = Callable[[Capture, Path], Mapping[str, Any]]


def capture_formats() -> list[str]:
    """Names of the installed layouts."""
    own = own_entry_points(CAPTURE_FORMATS)
    return sorted([*own, *listed(CAPTURE_FORMATS, own).usable])


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
    write = _writer(kind)
    with atomic_folder(folder, overwrite) as temporary:
        return write(capture, temporary)


def _writer(kind: str) -> Writer:
    own = own_entry_points(CAPTURE_FORMATS)
    if kind in own:
        found: Writer = own[kind].load()
        return found
    plugins = listed(CAPTURE_FORMATS, own)
    if kind not in plugins.usable and kind not in plugins.problems:
        installed = ", ".join(capture_formats()) or "(none is installed)"
        raise InputError(f"expected one of the layouts {installed}, found {kind!r}{nearest(kind, capture_formats())}")
    plugin = plugins.require(kind)
    write = plugin.load()

    def guarded_write(capture: Capture, folder: Path) -> Mapping[str, Any]:
        with guarded(plugin, "it wrote a capture"):
            report = write(capture, folder)
        if not isinstance(report, Mapping) or not isinstance(report.get("frames"), int):
            raise InputError(f"{plugin}: expected a report with the number of frames, found {str(report)[:60]!r}")
        return report

    return guarded_write
