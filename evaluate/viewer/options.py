"""Command-line options of ggavatar-view and their validation. Does not import torch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from ggavatar.cli.likely_device import device_default
from ggavatar.cli.page import CommandPage
from ggavatar.cli.training_help import BACKEND_NAMES
from ggavatar.cli.typed import one_of
from ggavatar.data.background import parse_background
from ggavatar.errors import InputError
from ggavatar.formats.source_options import GaussianFileOptions

DEFAULT_PORT = 8080
WAIT = "--wait"
"""Only ggavatar-train --view passes this: wait for a run that does not exist yet, end when the standard input ends."""
FIRST_CAMERA = "0"
"""What `--webcam` without a value means."""


@dataclass(frozen=True)
class Options:
    """Show a run, a capture or a file of Gaussians in a browser: turn it, move its face, play it, compare it."""

    shown: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="RUN|CAPTURE|FILE")]
    """Run folder of ggavatar-train, also while it trains; capture folder of ggavatar-prep; or FILE: an avatar file
    (docs/avatar-file.md), or Gaussians: PLY, .splat, .spz, SOG (docs/export.md)."""
    source: tyro.conf.OmitArgPrefixes[GaussianFileOptions] = field(default_factory=GaussianFileOptions)
    webcam: Annotated[str | None, tyro.conf.arg(metavar="N|VIDEO")] = None
    """Drive the avatar of a run by a camera of this computer (number N, 0 if not given), or by a video file in its
    place."""
    port: int = DEFAULT_PORT
    """Port of the address; the next free one is taken where it is in use, any free one for 0."""
    public: bool = False
    """Let other computers connect too: whoever reaches this one can watch and move what is shown."""
    background: str | None = None
    """Color behind the person: white, black, or R,G,B from 0 to 1; by default the run's own."""
    device: str = "auto"
    """Device of the rendering: auto, cpu, cuda, cuda:N or mps."""
    backend: str = "auto"
    """Rasterizer: auto, cpu, triton, gsplat or reference."""


PAGE = CommandPage(
    program="ggavatar-view",
    options=Options,
    summary="Show a run, a capture or a file of Gaussians in a browser: turn it, move its face, play it, compare it.",
    examples=(
        ("ggavatar-view runs/alice", "an avatar, also while it trains"),
        ("ggavatar-view captures/alice", "a capture: pictures, masks, head and findings"),
        ("ggavatar-view runs/alice --webcam", "an avatar that follows your face"),
    ),
    groups={
        "what is shown": ("webcam", "background", "capture"),
        "the address": ("port", "public"),
        "where it is computed": ("device", "backend"),
        "a file of Gaussians in place of a run": ("axes", "scales", "opacities", "head_model", "flame_params"),
    },
    defaults=device_default,
    checks={"backend": one_of("--backend", BACKEND_NAMES)},
)


def check(options: Options) -> None:
    """Validate the options before anything is loaded.

    Raises:
        InputError: A number is out of range, or a color is none.
    """
    if not 0 <= options.port <= 65535:
        raise InputError(f"expected --port from 0 to 65535, found {options.port}; {DEFAULT_PORT} is the default")
    if options.background is not None:
        parse_background(options.background)


def with_first_camera(arguments: Sequence[str]) -> list[str]:
    """The arguments with the value that `--webcam` may go without."""
    completed: list[str] = []
    for index, argument in enumerate(arguments):
        completed.append(argument)
        following = arguments[index + 1] if index + 1 < len(arguments) else "--"
        if argument == "--webcam" and following.startswith("-"):
            completed.append(FIRST_CAMERA)
    return completed
