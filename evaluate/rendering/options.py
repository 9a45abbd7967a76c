"""What ggavatar-render is asked for, and whether it can be meant."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from ggavatar.errors import InputError
from ggavatar.formats.source_options import GaussianFileOptions, is_gaussian_file


@dataclass(frozen=True)
class Options:
    """Draw a trained avatar: the frames of a split (default), an orbit around the head, or another performance."""

    run: tyro.conf.Positional[Path]
    """Run folder written by ggavatar-train, or FILE.ply of 3DGS or GaussianAvatars (docs/export.md)."""
    source: tyro.conf.OmitArgPrefixes[GaussianFileOptions] = field(default_factory=GaussianFileOptions)
    output_dir: Annotated[Path | None, tyro.conf.arg(aliases=("-o",))] = None
    """Folder to write; RUN/renders/WHAT if not given."""
    split: Literal["test", "train", "all"] = "test"
    """Which frames of the run's own capture to draw."""
    orbit: bool = False
    """Turn the camera around the head instead, the expression held; also writes novel_views.png."""
    drive: Path | None = None
    """Carry over the performance of a capture folder or an .npz instead; also writes reenactment.png."""
    transfer: Literal["relative", "absolute"] = "relative"
    """Add the driver's changes from its neutral frame to the avatar's neutral frame, or copy its coefficients."""
    pose: Literal["relative", "absolute", "still"] = "relative"
    """The same for the head's pose before the camera; still keeps that of the avatar's neutral frame."""
    smooth: Literal["none", "one-euro", "savgol"] = "savgol"
    """Filter for the driving performance."""
    limit: float = 0.15
    """How far a coefficient may leave the range seen in training, in widths of that range; negative for no limit."""
    neutral: int | None = None
    """Source frame number of the driver's neutral frame; found if not given."""
    target_neutral: int | None = None
    """Source frame number of the avatar's neutral frame, also held in an orbit; found if not given."""
    beside: tuple[Path, ...] = ()
    """Folders that --drive wrote for other runs and the same performance, as further rows of reenactment.png."""
    force_basis: bool = False
    """Accept a driver with another number of coefficients or version of the same family of bases."""
    yaw: float = 40.0
    """Largest turn of the orbit to either side, degrees."""
    pitch: float = 20.0
    """Largest turn of the orbit up and down, degrees."""
    views: int = 120
    """Number of pictures of the orbit."""
    frames: str | None = None
    """Part of the frames as START:STOP:STEP over their positions, such as 0:100:2."""
    width: int | None = None
    """Width of the pictures, px; the height follows. The capture's if not given."""
    background: str | None = None
    """white, black or R,G,B in 0-255; the run's own if not given."""
    alpha: bool = False
    """Write RGBA pictures with straight alpha too."""
    video: bool = True
    """Write render.mp4."""
    fps: float | None = None
    """Pictures per second of the video; that of the source if not given."""
    step: int | None = None
    """Step of the checkpoint; the newest if not given."""
    device: str = "auto"
    """auto, cpu, cuda, cuda:N or mps."""
    backend: str = "auto"
    """Rasteriser, as in ggavatar-train."""
    resume: bool = False
    """Go on with an interrupted render."""
    overwrite: bool = False
    """Replace an earlier render."""


def check(options: Options) -> None:
    """Refuse combinations that cannot be meant, before anything is loaded.

    Raises:
        InputError: Two things to draw at once, or a number out of range.
    """
    if options.orbit and options.drive is not None:
        raise InputError("expected --orbit or --drive, found both; run the command once for each")
    if is_gaussian_file(options.run) and options.source.capture is None and not options.orbit:
        raise InputError(
            f"{options.run}: a file of Gaussians has no cameras; add --capture DIR for those of a capture, or --orbit"
        )
    if options.resume and options.overwrite:
        raise InputError("expected --resume or --overwrite, found both; choose one")
    if options.views < 1 or not 0 <= options.yaw <= 180 or not 0 <= options.pitch <= 89:
        raise InputError("expected --views of 1 or more, --yaw of 0 to 180 and --pitch of 0 to 89 degrees")
    if options.width is not None and not 16 <= options.width <= 8192:
        raise InputError(f"expected --width of 16 to 8192 px, found {options.width}")
    if options.fps is not None and not 1 <= options.fps <= 240:
        raise InputError(f"expected --fps of 1 to 240, found {options.fps:g}")
