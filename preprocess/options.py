"""The options of `ggavatar-prep` as plain data; no stage reads the command line."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro


@dataclass(frozen=True)
class TrackingOptions:
    """Options of the built-in tracker, which runs when `--tracking` is not given."""

    focal: float | None = None
    """Focal length in px of the capture's images; estimated from the clip if not given."""

    expressions: int = 50
    """Number of expression coefficients of the subject's head; one more encodes the length of the neck."""

    smooth: bool = True
    """Smooth poses and expressions over time (zero-phase, so without lag)."""


@dataclass(frozen=True)
class PrepOptions:
    """Turn a portrait video into a capture that `ggavatar-train` can read."""

    input: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="VIDEO|FRAMES")]
    """A video file, or a folder of PNG or JPEG frames."""

    output_dir: Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="CAPTURE")]
    """Capture folder to write."""

    tracking: Annotated[Path | None, tyro.conf.arg(metavar="PATH")] = None
    """Another tracker's output, a folder or file; the built-in tracker runs if not given."""

    format: str = "auto"
    """Format of `--tracking`: one of the names listed, or auto to detect it."""

    head_model: Annotated[Path | None, tyro.conf.arg(aliases=["--head"], metavar="PATH")] = None
    """Head model of `--tracking` (required with it): head.npz, FLAME (pkl or npz), GNM (npz) or ICT-FaceKit (folder).

    If `--tracking` is not given, the built-in tracker fits this FLAME model.
    """

    masks: str = "auto"
    """Foreground masks: a folder of images, rvm (or a file of it, .onnx), selfie, grabcut, or auto.

    Auto takes the alpha channel of the video if it has one, else selfie.
    """

    invert_masks: bool = False
    """The masks in the `--masks` folder are white where the person is not."""

    camera: int | None = None
    """Camera to use where the names of images and masks tell several apart (00012_03.png); the first if not given."""

    size: int = 512
    """Longer side of the capture's images, px."""

    crop: str = "auto"
    """Crop: auto (one square around the head), none (the whole frame), or X,Y,WIDTH,HEIGHT in px of the video."""

    keep_faceless: bool = False
    """Keep frames without evidence of the person (blank, no face, empty mask), with poses from neighboring frames."""

    cut: str = "refuse"
    """If another person follows: auto keeps the longest part of one person, N the N-th part, all everything."""

    drop_repeated: bool = False
    """Drop frames that repeat the one before (frozen video, or one converted from a lower frame rate)."""

    fps: float | None = None
    """Keep at most this many frames per second; for an image folder, its frame rate (25 if not given)."""

    start: float = 0.0
    """Skip frames before this time, s."""

    end: float | None = None
    """Skip frames after this time, s."""

    frames: str = ":"
    """Frames to keep, as START:STOP:STEP in source frame numbers."""

    split: tuple[str, ...] = ()
    """Train/test splits in addition to every-20th: last-350, last-500, ratio-0.8, file:PATH."""

    subject: str | None = None
    """Subject's name in tables; the input's name if not given."""

    frame_offset: int | None = None
    """Source frame number minus tracking frame number; found by comparing images if not given."""

    fix: tuple[str, ...] = ()
    """Convention mistakes in `--tracking` to undo, by the names that ggavatar-doctor reports."""

    models: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Folder that is searched first for model files."""

    offline: bool = False
    """Never download model files."""

    strict: bool = False
    """Exit with code 3 if frames were lost or the doctor found a fault."""

    resume: bool = False
    """Resume in an existing output folder; stages whose inputs are unchanged are skipped."""

    overwrite: bool = False
    """Replace an existing capture that was made by this command."""

    refine: Literal["auto", "yes", "no"] = "auto"
    """Correct the tracking with a short avatar that draws the frames (about a minute); `--refine` alone is yes.

    Auto corrects our own tracking and keeps an imported one; `--no-refine` keeps both.
    """

    tracker: TrackingOptions = field(default_factory=TrackingOptions)

    quiet: Annotated[bool, tyro.conf.arg(aliases=["-q"])] = False
    """Print only warnings and errors."""

    json: bool = False
    """Print a machine-readable summary as the last line."""
