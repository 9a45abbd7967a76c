"""Avatars and captures as files of other programs."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any, TypedDict, Unpack, cast

from ggavatar.api.options import check_options
from ggavatar.api.performances import Performance
from ggavatar.api.runs import open_run
from ggavatar.data.capture import Capture
from ggavatar.errors import InputError, nearest
from ggavatar.formats.avatar_file.export import export_avatar_file
from ggavatar.formats.capture_layouts import capture_formats, export_capture
from ggavatar.formats.conversion import convert
from ggavatar.formats.drives import NamedDrive, frame_drives, neutral_drive
from ggavatar.formats.export import BOUND_FORMAT, ExportResult, export_bound, export_splats
from ggavatar.formats.source_options import GaussianReadingOptions, is_gaussian_file
from ggavatar.formats.splat_formats import AVATAR, WEB, chosen_format, splat_formats
from ggavatar.formats.web.clips import Clip
from ggavatar.formats.web.export import export_web
from ggavatar.formats.web.options import WebOptions
from ggavatar.training.run_folder import Run


class ExportOptions(TypedDict, total=False):
    """What an export may be given beside its format."""

    frames: tuple[int, ...]
    """Source frames of the run's capture to pose the avatar by; the neutral face if not given."""
    performance: Performance
    """A performance of `drive`: a page plays it, splats have a file a frame."""
    web: WebOptions
    """Options of the format web."""
    include_head_model: bool
    """Pass on a licensed head model with a page or an avatar file; only where its license allows that."""
    reading: GaussianReadingOptions
    """How the numbers of a file of Gaussians are meant."""
    overwrite: bool
    """Replace an earlier export."""


def export(
    source: Run | Capture | Path | str,
    output: Path | str,
    format: str | None = None,
    **options: Unpack[ExportOptions],
) -> ExportResult:
    """Write a run, a capture or a file of Gaussians for other programs, as `ggavatar-export` does.

    Args:
        source: A run or its folder, an avatar file, a file of Gaussians, or a capture or its folder.
        output: The file or folder to write.
        format: Of a run: web, avatar, ply, splat, spz, glb, that of a plug-in, or gaussian-avatars; of a capture: vhap,
            flash-avatar or that of a plug-in. By default that of the suffix of `output`, else ply.
        **options: As in `ExportOptions`.

    Raises:
        InputError: The source has no such format, or the output exists and must not be replaced.
    """
    check_options("export", options, ExportOptions)
    path, given = Path(output), cast(dict[str, Any], dict(options))
    kind, overwrite = chosen_format(format, path), bool(given.get("overwrite"))
    if isinstance(source, Capture):
        return _capture(source, path, kind, overwrite)
    if isinstance(source, Run):
        return _run(source, path, kind, given)
    source = Path(source)
    if is_gaussian_file(source):
        return convert(source, given.get("reading") or GaussianReadingOptions(), kind, path, overwrite)
    if (source / "capture.json").is_file():
        return _capture(Capture.open(source), path, kind, overwrite)
    return _run(open_run(source), path, kind, given)


def _capture(capture: Capture, path: Path, kind: str, overwrite: bool) -> ExportResult:
    report = export_capture(capture, kind, path, overwrite)
    return ExportResult(path, 0, tuple(report.get("notes", ())))


def _run(run: Run, path: Path, kind: str, options: dict[str, Any]) -> ExportResult:
    known = (*splat_formats(), BOUND_FORMAT, WEB, AVATAR)
    overwrite, performance = bool(options.get("overwrite")), options.get("performance")
    if kind not in known:
        of_capture = "; it is a format of captures" if kind in capture_formats() else nearest(kind, known)
        raise InputError(f"unknown format {kind!r} of a run{of_capture}; known are {', '.join(known)}")
    if kind == WEB:
        return _page(run, path, options)
    if kind == AVATAR:
        written = export_avatar_file(run, path, overwrite, bool(options.get("include_head_model")))
        return ExportResult(path, 0, written.notes)
    if performance is not None:
        pairs = zip(performance.frames, performance.drives, strict=True)
        drives = [NamedDrive(f"{number:06d}", drive) for number, drive in pairs]
    else:
        drives = frame_drives(run, tuple(options.get("frames", ()))) or [neutral_drive(run, run.head)]
    if kind == BOUND_FORMAT:
        return export_bound(run, run.head, drives[0].drive, path, overwrite)
    return export_splats(run, drives, kind, path, overwrite)


def _page(run: Run, path: Path, options: dict[str, Any]) -> ExportResult:
    performance, web = options.get("performance"), options.get("web") or WebOptions()
    if options.get("include_head_model"):
        web = dataclasses.replace(web, include_head_model=True)
    clips = []
    if performance is not None:
        clips = [Clip("performance", performance.fps, performance.frames, performance.drives, performance.cameras)]
    written = export_web(run, web, path, bool(options.get("overwrite")), clips)
    return ExportResult(path, written.gaussians, written.notes)
