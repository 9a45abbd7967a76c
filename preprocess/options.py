"""Everything `ggavatar-prep` can be told, as plain data. No stage reads the command line."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro


@dataclass(frozen=True)
class TrackingOptions:
    """Of the built-in tracker, used when no `--tracking` is given."""

    focal: float | None = None
    """Focal length in px of the capture's images; found from the clip if not given."""

    expressions: int = 50
    """How many expression coefficients the subject's head gets; the length of the neck is one more."""

    smooth: bool = True
    """Smooth poses and expressions over time, without lag."""


@dataclass(frozen=True)
class PrepOptions:
    """From a portrait video to a capture that `ggavatar-train` can read."""

    input: tyro.conf.Positional[Path]
    """A video file, or a folder of PNG or JPEG frames."""

    output_dir: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """The capture folder to write."""

    tracking: Annotated[Path | None, tyro.conf.arg(metavar="PATH")] = None
    """Folder or file of another tracker's output. Without it the built-in tracker runs."""

    format: str = "auto"
    """Format of `--tracking`: a name that is listed above, or auto."""

    head_model: Annotated[Path | None, tyro.conf.arg(aliases=["--head"], metavar="FILE")] = None
    """Head that the tracking's parameters belong to: head.npz, or FLAME's generic_model.pkl, flame2023.pkl or npz."""

    masks: str = "auto"
    """A folder of masks; an RVM file (.onnx, .torchscript); or auto, selfie, grabcut."""

    size: int = 512
    """Side of the square images to make, px."""

    crop: str = "auto"
    """auto (one square around the head), none (the whole frame), or X,Y,WIDTH,HEIGHT in px of the video."""

    fps: float | None = None
    """Keep at most this many frames per second; for an image folder, its rate (25 if not given)."""

    start: float = 0.0
    """Leave out what comes before this time, s."""

    end: float | None = None
    """Leave out what comes after this time, s."""

    frames: str = ":"
    """Frames to keep, START:STOP:STEP in source frame numbers."""

    split: tuple[str, ...] = ()
    """Further train/test rules beside every-20th: last-350, last-500, ratio-0.8, file:PATH."""

    subject: str | None = None
    """Name in tables; the input's name if not given."""

    frame_offset: int | None = None
    """Source frame number minus tracking number; found by silhouette overlap if not given."""

    fix: tuple[str, ...] = ()
    """Undo mistakes in the conventions of `--tracking`, by the names ggavatar-doctor gives them."""

    models: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Folder with model files, looked into first."""

    offline: bool = False
    """Never download anything."""

    strict: bool = False
    """Exit with 3 if frames were lost or the doctor found a fault."""

    resume: bool = False
    """Continue in an existing output folder; stages whose inputs are unchanged are skipped."""

    overwrite: bool = False
    """Replace an existing capture made by this command."""

    tracker: TrackingOptions = field(default_factory=TrackingOptions)

    quiet: Annotated[bool, tyro.conf.arg(aliases=["-q"])] = False
    """Say nothing but warnings and errors."""

    json: bool = False
    """Print a machine-readable summary as the last line."""
