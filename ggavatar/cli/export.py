"""ggavatar-export: write an avatar or a file of Gaussians for other programs, or a capture for other trainers."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from tyro.conf import Positional, arg

from ggavatar.cli.given import A_CAPTURE, AN_AVATAR, CAPTURE, check_given, clean_stem, kind_of
from ggavatar.cli.likely_device import device_default
from ggavatar.cli.page import CommandPage, parse
from ggavatar.cli.progress import announce_start
from ggavatar.cli.run import run_command
from ggavatar.errors import InputError, nearest
from ggavatar.formats.avatar_suffix import SUFFIX as AVATAR_SUFFIX
from ggavatar.formats.avatar_suffix import is_avatar_file
from ggavatar.formats.capture_layouts import capture_formats, export_capture
from ggavatar.formats.driving_options import DrivingOptions
from ggavatar.formats.source_options import GaussianReadingOptions, is_gaussian_file
from ggavatar.formats.splat_formats import (
    AVATAR,
    PAGE_SUFFIXES,
    WEB,
    chosen_format,
    plugged_format,
    problems,
    splat_formats,
    written_suffixes,
)
from ggavatar.formats.splat_formats import OWN as OWN_SPLAT_FORMATS
from ggavatar.formats.web.options import WebOptions
from ggavatar.io.held_folders import hold_folder
from ggavatar.text.terminal import write_out

if TYPE_CHECKING:
    from ggavatar.formats.drives import NamedDrive
    from ggavatar.training.run_folder import Run

SUBMISSION = "nersemble-submission"
OTHER_RUN_FORMATS = ("gaussian-avatars", WEB, AVATAR)
_NEXT_STEPS = {
    "vhap": "in GaussianAvatars: python train.py -s {path} --bind_to_mesh --white_background",
    "flash-avatar": "make parsing/%05d_neckhead.png and _mouth.png for FlashAvatar, then train it on {path}",
}


@dataclass(frozen=True)
class Arguments:
    """Write a trained avatar or a file of Gaussians for other programs, or a capture for other trainers."""

    source: Positional[Path]
    """Run folder of ggavatar-train, avatar file (.ggavatar), FILE of Gaussians (PLY, .splat, .spz, SOG), capture folder
    of ggavatar-prep, or (nersemble-submission) folder of renderings."""
    format: str | None = None
    """Of a run or avatar file: web (a page that shows and drives it), avatar (one file to view, render and export
    like the run), ply, splat, spz, glb (for viewers) or gaussian-avatars (bound to the mesh); of FILE: ply, splat, spz
    or glb; of a capture or of renderings: those listed. By default that of the suffix of --output, else ply."""
    output: Annotated[Path | None, arg(aliases=["-o"], metavar="PATH")] = None
    """File or folder to write; RUN/exports/…, FILE.FORMAT or CAPTURE-FORMAT if not given."""
    neutral: bool = False
    """Export the neutral face, as without --frame and --drive."""
    frame: tuple[int, ...] = ()
    """Export these source frames of the run's capture, one file each."""
    drive: Path | None = None
    """A performance, carried over as ggavatar-render --drive does (docs/driving.md): web plays it, splats have a file a
    frame."""
    capture: Annotated[Path | None, arg(metavar="DIR")] = None
    """Where the capture of a run is now, if it was moved away from the run."""
    step: int | None = None
    """Step of the checkpoint; the newest if not given."""
    device: str = "auto"
    """Device of the rendering: auto, cpu, cuda, cuda:N or mps."""
    overwrite: bool = False
    """Replace an earlier export."""
    reading: tyro.conf.OmitArgPrefixes[GaussianReadingOptions] = field(default_factory=GaussianReadingOptions)
    driving: tyro.conf.OmitArgPrefixes[DrivingOptions] = field(default_factory=DrivingOptions)
    web: tyro.conf.OmitArgPrefixes[WebOptions] = field(default_factory=WebOptions)

    @property
    def kind(self) -> str:
        """The format to write."""
        return chosen_format(self.format, self.output)

    @property
    def poses(self) -> int:
        """How many flags choose the poses of an avatar; they exclude each other."""
        return sum([bool(self.frame), self.drive is not None, self.neutral])


def _run_formats() -> tuple[str, ...]:
    return (*splat_formats(), *OTHER_RUN_FORMATS)


def _layouts() -> list[str]:
    return [
        "formats (--format), by what is exported:",
        f"  run, avatar file     {', '.join(_run_formats())}",
        f"  file of Gaussians    {', '.join(splat_formats())}",
        f"  capture              {', '.join(capture_formats()) or 'none installed'}",
        f"  rendered frames      {SUBMISSION} (NeRSemble's benchmark)",
    ]


PAGE = CommandPage(
    program="ggavatar-export",
    options=Arguments,
    summary="Write a trained avatar or a file of Gaussians for other programs, or a capture for other trainers.",
    examples=(
        ("ggavatar-export runs/alice -o alice.html", "a page that shows and drives the avatar in any browser"),
        (
            "ggavatar-export runs/alice -o alice.ggavatar",
            "one file to view, render and export like the run",
        ),
        ("ggavatar-export captures/alice --format vhap", "a capture for GaussianAvatars"),
    ),
    groups={
        "what is written": ("format", "output", "overwrite"),
        "pose of the avatar": ("neutral", "frame", "drive"),
        "the run": ("capture", "step", "device"),
        "how --drive carries a performance over": tuple(field.name for field in fields(DrivingOptions)),
        "pages and avatar files": tuple(field.name for field in fields(WebOptions)),
        "files of Gaussians": tuple(field.name for field in fields(GaussianReadingOptions)),
    },
    defaults=device_default,
    listing=_layouts,
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of ggavatar-export; returns the exit code (0 success, 1 failure, 2 invalid input)."""
    return run_command(lambda: _export(parse(PAGE, arguments)), Arguments)


def _export(arguments: Arguments) -> int:
    """Export a run, a file or a capture, depending on the format, and print what was written."""
    known = (*_run_formats(), *capture_formats(), SUBMISSION)
    kind = arguments.kind
    if kind in problems():
        plugged_format(kind)  # which says what is wrong with it
    if kind not in known:
        stale = "" if capture_formats() else "; for formats of captures, run pip install -e . again"
        raise InputError(f"unknown format {kind!r}{nearest(kind, known)}; known formats are {', '.join(known)}{stale}")
    _check_suffix(arguments)
    _check_web_options(arguments)
    if arguments.driving != DrivingOptions() and arguments.drive is None:
        raise InputError("--transfer, --pose, --smooth, --limit and the like belong to --drive; leave them out")
    _check_source(arguments)
    exporter = _exporter(arguments)
    if arguments.capture is not None and exporter is not _export_run:
        raise InputError(f"{arguments.source}: --capture belongs to a run, found another source; leave it out")
    with hold_folder(arguments.source) if arguments.source.is_dir() else contextlib.nullcontext():
        lines = exporter(arguments)
    write_out(*lines)
    return 0


def _check_source(arguments: Arguments) -> None:
    """Refuse a source that the format cannot be made of, and say which format it has."""
    if arguments.kind == SUBMISSION:
        return
    source = arguments.source
    if arguments.format is None and kind_of(source) == CAPTURE:
        layouts = capture_formats()
        raise InputError(
            f"{source}: expected a run folder, found a capture; for other trainers: ggavatar-export {source} --format "
            f"{' or '.join(layouts) or 'LAYOUT'}; "
            f"for an avatar, train on it first: ggavatar-train {source} -o runs/{clean_stem(source)}"
        )
    check_given(source, AN_AVATAR if arguments.kind in _run_formats() else A_CAPTURE)


def _check_web_options(arguments: Arguments) -> None:
    """Refuse options of pages for what is no page; an avatar file may contain the head model too."""
    kind, web = arguments.kind, arguments.web
    shared = WebOptions(include_head_model=web.include_head_model) if kind == AVATAR else WebOptions()
    if web != shared and kind != WEB:
        raise InputError(f"--format {kind}: options of web pages belong to --format {WEB}; leave them out")


def _exporter(arguments: Arguments) -> Callable[[Arguments], list[str]]:
    """What writes the format, from the kind of source."""
    if arguments.kind == SUBMISSION:
        return _export_submission
    if is_gaussian_file(arguments.source):
        return _export_file
    return _export_run if arguments.kind in _run_formats() else _export_capture


def _check_suffix(arguments: Arguments) -> None:
    """Refuse a name of --output that says another format than the one written; several poses go into a folder."""
    kind, output = arguments.kind, arguments.output
    if kind == AVATAR and output is not None and output.suffix.lower() != AVATAR_SUFFIX:
        raise InputError(f"-o {output}: expected a file name that ends with {AVATAR_SUFFIX} for --format {AVATAR}")
    if kind == WEB and output is not None and output.suffix.lower() not in PAGE_SUFFIXES:
        raise InputError(f"-o {output}: expected a file name that ends with .html for --format {WEB}")
    if kind not in splat_formats() or output is None or not output.suffix or len(arguments.frame) > 1:
        return
    meant = written_suffixes().get(output.suffix.lower())
    if meant == kind or (arguments.format and meant is None):
        return
    can = ", ".join(f".{name}" for name in splat_formats())
    found = f"--format {arguments.format}" if arguments.format else "a suffix that cannot be written"
    raise InputError(f"-o {output}: expected a file name with the suffix of its format ({can}), found {found}")


def _export_file(arguments: Arguments) -> list[str]:
    """Write a file of Gaussians in another format."""
    from ggavatar.formats.conversion import convert

    source, kind = arguments.source, arguments.kind
    if arguments.poses or arguments.step is not None or kind not in splat_formats():
        raise InputError(
            f"{source}: a file of Gaussians is written as {', '.join(splat_formats())}, without --neutral, --frame, "
            "--drive and --step"
        )
    beside = source.parent if source.name == "meta.json" else source
    path = arguments.output or beside.with_name(f"{beside.name if beside.is_dir() else beside.stem}.{kind}")
    result = convert(source, arguments.reading, kind, path, arguments.overwrite)
    notes = [f"note: {note}" for note in result.notes]
    return [
        f"wrote {path} ({_size_text(1, result.gaussians)})",
        *notes,
        f"next: {_next_step_for_splats(path, kind, 1)}",
    ]


def _export_submission(arguments: Arguments) -> list[str]:
    """Pack rendered frames into the zip that NeRSemble's benchmark takes."""
    from ggavatar.formats.nersemble_submission import write_submission

    path = arguments.output or arguments.source.resolve().with_suffix(".zip")
    written = write_submission(arguments.source, path, arguments.overwrite)
    lines = [f"wrote {written.path} ({len(written.videos)} videos, {written.frames} frames)"]
    if written.missing:
        lines.append(f"note: a complete submission has {len(written.missing)} more, such as {written.missing[0]}")
    return lines


def _export_capture(arguments: Arguments) -> list[str]:
    from ggavatar.data.capture import Capture

    if arguments.poses or arguments.step is not None:
        raise InputError(
            f"--format {arguments.kind} writes a whole capture; leave out --neutral, --frame, --drive and --step"
        )
    if not (arguments.source / "capture.json").is_file():
        raise InputError(
            f"{arguments.source}: expected a capture folder for --format {arguments.kind}, found no capture.json"
        )
    capture = Capture.open(arguments.source)
    home = arguments.source.resolve()
    folder = arguments.output or home.with_name(f"{home.name}-{arguments.kind}")
    report = export_capture(capture, arguments.kind, folder, arguments.overwrite)
    notes = [f"note: {note}" for note in report.get("notes", ())]
    step = _NEXT_STEPS.get(arguments.kind)
    following = [f"next: {step.format(path=folder)}"] if step else []
    return [f"wrote {folder} ({report['frames']} frames)", *notes, *following]


def _export_run(arguments: Arguments) -> list[str]:
    if arguments.poses > 1:
        raise InputError("expected one of --neutral, --frame and --drive, found several; run the command once for each")
    if not (arguments.source / "config.json").is_file() and not is_avatar_file(arguments.source):
        raise InputError(
            f"{arguments.source}: expected a run folder or an avatar file for --format {arguments.kind}, found no "
            "config.json in it"
        )
    if arguments.reading.are_given:
        raise InputError(
            f"{arguments.source}: --axes, --scales and --opacities belong to a file of Gaussians; omit them"
        )
    announce_start()
    from ggavatar.formats.any_avatar import open_avatar
    from ggavatar.formats.drives import frame_drives, neutral_drive
    from ggavatar.formats.export import BOUND_FORMAT, POINT_CLOUD_FILE, export_bound, export_splats
    from ggavatar.render.backends import resolve_device
    from ggavatar.training.same_capture import change_since_training

    device = resolve_device(arguments.device)
    run = open_avatar(arguments.source, device, arguments.step, capture=arguments.capture)
    if arguments.kind in (WEB, AVATAR):
        return _export_page(arguments, run) if arguments.kind == WEB else _export_avatar(arguments, run)
    head = run.head
    carried_notes: list[str] = []
    if arguments.drive is not None:
        drives, carried_notes = _carried_drives(arguments, run)
    else:
        drives = frame_drives(run, arguments.frame) if arguments.frame else [neutral_drive(run, head)]
    path = arguments.output or _default_path(arguments, run, [drive.name for drive in drives])
    if arguments.kind == BOUND_FORMAT:
        if len(drives) > 1:
            raise InputError(f"{BOUND_FORMAT} stores one binding that follows the mesh; pass one --frame or --neutral")
        result = export_bound(run, head, drives[0].drive, path, arguments.overwrite)
        capture = run.capture.folder if run.capture.folder.is_dir() else "CAPTURE, which the avatar was trained on"
        following = f"ggavatar-render {path / POINT_CLOUD_FILE} --capture {capture}"
    else:
        result = export_splats(run, drives, arguments.kind, path, arguments.overwrite)
        following = _next_step_for_splats(path, arguments.kind, len(drives))
    changed = [change] if (change := change_since_training(run)) else []
    notes = [f"note: {note}" for note in (*changed, *carried_notes, *result.notes, *_renderer_notes(run.method))]
    return [f"wrote {result.path} ({_size_text(len(drives), result.gaussians)})", *notes, f"next: {following}"]


def _carried_drives(arguments: Arguments, run: Run) -> tuple[list[NamedDrive], list[str]]:
    """The drives of a performance, one for each file, and notes on them."""
    from ggavatar.formats.drives import NamedDrive
    from ggavatar.formats.performances import carried_over

    assert arguments.drive is not None
    found = carried_over(run, arguments.drive, arguments.driving)
    drives = [NamedDrive(f"{number:06d}", drive) for number, drive in zip(found.frames, found.drives, strict=True)]
    smaller = (
        f"a file a frame is large; --format {WEB} plays the performance in one page, and an avatar file (--format "
        f"{AVATAR}) performs it with ggavatar-render FILE --drive {arguments.drive}"
    )
    return drives, [*([found.note] if found.note else []), *([smaller] if len(drives) > 1 else [])]


def _export_avatar(arguments: Arguments, run: Run) -> list[str]:
    """Write a run as one file."""
    from ggavatar.formats.avatar_file.export import export_avatar_file

    if arguments.poses:
        raise InputError(
            f"--format {AVATAR} holds the avatar for every pose; leave out --frame, --neutral and --drive, and drive "
            "the file with ggavatar-render FILE --drive"
        )
    path = arguments.output or run.folder / "exports" / f"avatar{AVATAR_SUFFIX}"
    written = export_avatar_file(run, path, arguments.overwrite, arguments.web.include_head_model)
    notes = [f"note: {note}" for note in written.notes]
    return [f"wrote {path} ({written.bytes / 1e6:.2f} MB)", *notes, f"next: ggavatar-render {path} --orbit"]


def _export_page(arguments: Arguments, run: Run) -> list[str]:
    """Write the page of a run."""
    from ggavatar.formats.performances import carried_over
    from ggavatar.formats.web.clips import Clip
    from ggavatar.formats.web.export import export_web

    if arguments.frame or arguments.neutral:
        raise InputError(f"--format {WEB} shows all poses; leave out --frame and --neutral")
    clips, carried_notes = [], []
    if arguments.drive is not None:
        found = carried_over(run, arguments.drive, arguments.driving)
        clips = [Clip(arguments.drive.name, found.fps, found.frames, found.drives, found.cameras)]
        carried_notes = [found.note] if found.note else []
    path = arguments.output or run.folder / "exports" / "avatar.html"
    written = export_web(run, arguments.web, path, arguments.overwrite, clips)
    against = "" if written.psnr is None else f", {written.psnr:.1f} dB against the run"
    size = f"{written.bytes / 1e6:.2f} MB, {written.gaussians} of {written.before} Gaussians{against}"
    notes = [f"note: {note}" for note in (*carried_notes, *written.notes)]
    return [f"wrote {written.path} ({size})", *notes, "next: open it in a browser; it needs no network and no server"]


def _renderer_notes(method: str) -> list[str]:
    """A note on methods whose avatars are not made to be rendered as Gaussians."""
    from ggavatar.training.registry import load

    if not hasattr(load(method).module, "rasterizer"):
        return []
    return [f"{method} has a renderer of its own; it looks different in viewers of Gaussians"]


def _default_path(arguments: Arguments, run: Run, names: Sequence[str]) -> Path:
    """The path of an export among the results of its run."""
    home = run.folder / "exports"
    if arguments.kind == "gaussian-avatars":
        return home / arguments.kind
    if len(names) > 1:
        return home / f"{arguments.drive.stem if arguments.drive else 'frames'}-{arguments.kind}"
    return home / f"{names[0]}.{arguments.kind}"


def _size_text(files: int, gaussians: int) -> str:
    return f"{gaussians} Gaussians" if files == 1 else f"{files} files of up to {gaussians} Gaussians"


def _next_step_for_splats(path: Path, kind: str, files: int) -> str:
    if kind not in OWN_SPLAT_FORMATS:
        return f"open {path} with the program that reads .{kind}"
    if kind != "glb" and files == 1:
        return f"ggavatar-render {path} --orbit, or open it in any viewer of Gaussian splats"
    if kind == "glb":
        return "open it in a viewer of KHR_gaussian_splatting, such as the PlayCanvas or Babylon.js viewer"
    return "open them in a viewer of Gaussian splats, such as SuperSplat"


if __name__ == "__main__":
    sys.exit(main())
