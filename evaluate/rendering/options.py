"""Command-line options of ggavatar-render and their validation."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated, Literal

import tyro

from ggavatar.cli.likely_device import device_default
from ggavatar.cli.page import CommandPage
from ggavatar.cli.training_help import BACKEND_NAMES
from ggavatar.cli.typed import one_of
from ggavatar.data.background import parse_background
from ggavatar.errors import InputError
from ggavatar.formats.driving_options import RenderDrivingOptions
from ggavatar.formats.source_options import GaussianFileOptions, is_gaussian_file


@dataclass(frozen=True)
class Options:
    """Render a trained avatar: the frames of a split (default), an orbit around the head, or a driving sequence."""

    run: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="RUN|FILE")]
    """Run folder of ggavatar-train, avatar file (.ggavatar), or FILE of Gaussians: PLY, .splat, .spz, SOG."""
    source: tyro.conf.OmitArgPrefixes[GaussianFileOptions] = field(default_factory=GaussianFileOptions)
    output_dir: Annotated[Path | None, tyro.conf.arg(aliases=("-o",), metavar="DIR")] = None
    """Output folder; by default RUN/renders/WHAT."""
    split: Literal["test", "train", "all"] = "test"
    """Which frames of the run's own capture to render."""
    orbit: bool = False
    """Render an orbit around the head with a fixed expression instead; also writes novel_views.png."""
    drive: Path | None = None
    """Drive the avatar with another performance instead (docs/driving.md): a capture folder, an .npz of head
    parameters, or a recording of ARKit's or MediaPipe's scores (CSV, JSON, npz); also writes reenactment.png."""
    driving: tyro.conf.OmitArgPrefixes[RenderDrivingOptions] = field(default_factory=RenderDrivingOptions)
    beside: tuple[Path, ...] = ()
    """Output folders of --drive for other runs and the same driving sequence: additional rows of reenactment.png."""
    yaw: float = 40.0
    """Largest yaw of the orbit to either side, degrees."""
    pitch: float = 20.0
    """Largest pitch of the orbit up and down, degrees."""
    views: int = 120
    """Number of images of the orbit."""
    frames: str | None = None
    """Subset of the frames by position, START:STOP:STEP, such as 0:100:2."""
    width: int | None = None
    """Image width, px; the height follows from the aspect ratio. By default the capture's."""
    background: str | None = None
    """Color behind the person: white, black, or R,G,B from 0 to 1; by default the run's own."""
    alpha: bool = False
    """Also write RGBA images with straight alpha."""
    video: bool = True
    """Write render.mp4."""
    fps: float | None = None
    """Frames per second of the video; by default that of the source."""
    step: int | None = None
    """Step of the checkpoint; by default the newest."""
    device: str = "auto"
    """Device of the rendering: auto, cpu, cuda, cuda:N or mps."""
    backend: str = "auto"
    """Rasterizer: auto, cpu, triton, gsplat or reference."""
    resume: bool = False
    """Resume an interrupted call: keep the images that are already there."""
    overwrite: bool = False
    """Replace the output of an earlier call."""


PAGE = CommandPage(
    program="ggavatar-render",
    options=Options,
    summary="Render a trained avatar: the frames of a split, an orbit around the head, or a driving performance.",
    examples=(
        ("ggavatar-render runs/alice", "the test frames, as PNG and video"),
        ("ggavatar-render runs/alice --orbit --views 60", "around the head"),
        ("ggavatar-render runs/alice --drive captures/bob -o bob-drives-alice", "with another person's performance"),
    ),
    groups={
        "what is rendered": ("split", "orbit", "drive", "frames", "beside"),
        "the orbit": ("yaw", "pitch", "views"),
        "how --drive carries a performance over": tuple(field.name for field in fields(RenderDrivingOptions)),
        "pictures": ("width", "background", "alpha", "video", "fps"),
        "what is written": ("output_dir", "resume", "overwrite"),
        "the run, and where it is computed": ("capture", "step", "device", "backend"),
        "a file of Gaussians in place of a run": (
            "axes",
            "scales",
            "opacities",
            "head_model",
            "flame_params",
        ),
    },
    defaults=device_default,
    checks={"backend": one_of("--backend", BACKEND_NAMES)},
)


def check(options: Options) -> None:
    """Validate the options before anything is loaded.

    Raises:
        InputError: Mutually exclusive options, or a number out of range.
    """
    if options.orbit and options.drive is not None:
        raise InputError("--orbit and --drive are mutually exclusive; run the command once for each")
    if is_gaussian_file(options.run) and options.source.capture is None and not options.orbit:
        raise InputError(
            f"{options.run}: a file of Gaussians has no cameras; add --capture DIR for those of a capture, or --orbit"
        )
    if options.background is not None:
        parse_background(options.background)
    if options.resume and options.overwrite:
        raise InputError("--resume and --overwrite are mutually exclusive; choose one")
    if options.views < 1 or not 0 <= options.yaw <= 180 or not 0 <= options.pitch <= 89:
        raise InputError("expected --views of 1 or more, --yaw of 0 to 180 and --pitch of 0 to 89 degrees")
    if options.width is not None and not 16 <= options.width <= 8192:
        raise InputError(f"expected --width of 16 to 8192 px, found {options.width}")
    if options.fps is not None and not 1 <= options.fps <= 240:
        raise InputError(f"expected --fps of 1 to 240, found {options.fps:g}")
