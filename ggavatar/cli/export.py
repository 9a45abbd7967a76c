"""ggavatar-export: a trained avatar for other programs, or a capture for others' trainers."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from tyro.conf import Positional, arg

from ggavatar.cli.run import run_command
from ggavatar.cli.version import answer_version
from ggavatar.errors import InputError, nearest
from ggavatar.formats.capture_layouts import capture_formats, export_capture

RUN_FORMATS = ("ply", "splat", "spz", "gaussian-avatars")
_NEXT = {
    "vhap": "in GaussianAvatars: python train.py -s {path} --bind_to_mesh --white_background",
    "flash-avatar": "make parsing/%05d_neckhead.png and _mouth.png for FlashAvatar, then train it on {path}",
}


@dataclass(frozen=True)
class Arguments:
    """Write a trained avatar for viewers and other programs, or a capture for others' trainers."""

    source: Positional[Path]
    """Run folder written by ggavatar-train, or capture folder written by ggavatar-prep."""
    format: str = "ply"
    """Of a run: ply, splat, spz (viewers) or gaussian-avatars (bound to the mesh). Of a capture: see below."""
    output: Annotated[Path | None, arg(aliases=["-o"], metavar="PATH")] = None
    """File or folder to write; RUN/exports/…, or CAPTURE-FORMAT, if not given."""
    neutral: bool = False
    """Bake the neutral face; this is what is done if nothing else is asked for."""
    frame: tuple[int, ...] = ()
    """Bake these source frames of the run's capture, a file for each."""
    drive: Path | None = None
    """Bake every row of an .npz of head parameters (as of ggavatar-render --drive, or a flame_param.npz)."""
    step: int | None = None
    """Step of the checkpoint; the newest if not given."""
    device: str = "auto"
    """auto, cpu, cuda or cuda:N."""
    overwrite: bool = False
    """Replace an earlier export."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point; the exit code is 0 done, 1 failure, 2 bad input."""
    given = None if arguments is None else list(arguments)
    config = (tyro.conf.FlagCreatePairsOff,)
    answer_version("ggavatar-export", given)
    parsed = tyro.cli(Arguments, prog="ggavatar-export", args=given, description=_description(), config=config)
    return run_command(lambda: _export(parsed))


def _description() -> str:
    layouts = ", ".join(capture_formats()) or "none installed"
    return (
        f"{Arguments.__doc__}\n\nLayouts of a capture: {layouts}.\n"
        "Examples: ggavatar-export runs/me --format spz, ggavatar-export data/me --format vhap"
    )


def _export(arguments: Arguments) -> int:
    """Tell a run from a capture, write, and say what was written."""
    known = (*RUN_FORMATS, *capture_formats())
    kind = arguments.format
    if kind not in known:
        stale = "" if capture_formats() else "; layouts of captures are missing, run pip install -e . again"
        raise InputError(f"unknown format {kind!r}{nearest(kind, known)}; known are {', '.join(known)}{stale}")
    lines = _export_run(arguments) if kind in RUN_FORMATS else _export_capture(arguments)
    sys.stdout.write("".join(f"{line}\n" for line in lines))
    return 0


def _export_capture(arguments: Arguments) -> list[str]:
    from ggavatar.data.capture import Capture

    if arguments.frame or arguments.drive or arguments.neutral or arguments.step is not None:
        raise InputError(f"--format {arguments.format} writes a whole capture; leave out --neutral, --frame, --drive")
    if not (arguments.source / "capture.json").is_file():
        raise InputError(
            f"{arguments.source}: expected a capture folder for --format {arguments.format}, found no capture.json"
        )
    capture = Capture.open(arguments.source)
    home = arguments.source.resolve()
    folder = arguments.output or home.with_name(f"{home.name}-{arguments.format}")
    report = export_capture(capture, arguments.format, folder, arguments.overwrite)
    notes = [f"note: {note}" for note in report.get("notes", ())]
    after = [f"next: {text.format(path=folder)}" for text in [_NEXT.get(arguments.format, "")] if text]
    return [f"wrote {folder} ({report['frames']} frames)", *notes, *after]


def _export_run(arguments: Arguments) -> list[str]:
    wishes = [bool(arguments.frame), arguments.drive is not None, arguments.neutral]
    if sum(wishes) > 1:
        raise InputError("expected one of --neutral, --frame and --drive, found several; run the command once for each")
    if not (arguments.source / "config.json").is_file():
        raise InputError(
            f"{arguments.source}: expected a run folder for --format {arguments.format}, found no config.json in it"
        )
    import torch

    from ggavatar.formats.export import BOUND, POINT_CLOUD, export_bound, export_splats
    from ggavatar.formats.poses import file_poses, frame_poses, neutral_pose
    from ggavatar.head.files import load_head
    from ggavatar.training.run_folder import open_run

    device = ("cuda" if torch.cuda.is_available() else "cpu") if arguments.device == "auto" else arguments.device
    run = open_run(arguments.source, device, arguments.step)
    head = load_head(run.capture.head_path).to(device, torch.float32)
    if arguments.drive is not None:
        poses = file_poses(arguments.drive, run, head)
    else:
        poses = frame_poses(run, arguments.frame) if arguments.frame else [neutral_pose(run, head)]
    path = arguments.output or _default_path(arguments, [pose.name for pose in poses])
    if arguments.format == BOUND:
        if len(poses) > 1:
            raise InputError(f"{BOUND} is bound in one pose and moves with the mesh; give one --frame or --neutral")
        written = export_bound(run, head, poses[0], path, arguments.overwrite)
        after = f"ggavatar-render {path / POINT_CLOUD} --capture {run.capture.folder}"
    else:
        written = export_splats(run, poses, arguments.format, path, arguments.overwrite)
        after = _after_splats(path, arguments.format, len(poses))
    notes = [f"note: {note}" for note in (*written.notes, *_drawn_otherwise(run.method))]
    return [f"wrote {written.path} ({_counted(len(poses), written.gaussians)})", *notes, f"next: {after}"]


def _drawn_otherwise(method: str) -> list[str]:
    """A word about methods that are not made to be drawn as Gaussians."""
    from ggavatar.training.registry import load

    if not hasattr(load(method).module, "rasterizer"):
        return []
    return [f"{method} has a renderer of its own; viewers of Gaussians draw it otherwise"]


def _default_path(arguments: Arguments, names: Sequence[str]) -> Path:
    """Beside the run's other results."""
    home = arguments.source / "exports"
    if arguments.format == "gaussian-avatars":
        return home / arguments.format
    if len(names) > 1:
        return home / f"{arguments.drive.stem if arguments.drive else 'frames'}-{arguments.format}"
    return home / f"{names[0]}.{arguments.format}"


def _counted(files: int, gaussians: int) -> str:
    return f"{gaussians} Gaussians" if files == 1 else f"{files} files of up to {gaussians} Gaussians"


def _after_splats(path: Path, kind: str, files: int) -> str:
    if kind == "ply" and files == 1:
        return f"ggavatar-render {path} --orbit, or open it in any viewer of Gaussian splats"
    return "open it in a viewer of Gaussian splats, such as SuperSplat"


if __name__ == "__main__":
    sys.exit(main())
