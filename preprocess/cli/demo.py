"""`ggavatar-demo`: a license-free person as a user's data would be.

A video, its mattes, a tracker's files and a head model.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from ggavatar.cli.run import run_command
from ggavatar.cli.version import answer_version
from ggavatar.errors import InputError


@dataclass(frozen=True)
class Options:
    """Write an embedded subject: video.mp4, masks/, tracking/, head.npz and truth.npz."""

    output_dir: Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="DIR")]
    """Folder to write; must be new or empty."""
    identity: Annotated[Literal[1, 2, 3, 4, 5], tyro.conf.arg(name="id")] = 1
    """Which of the five people."""
    frames: int = 600
    """Length at 25 frames a second."""
    size: int = 512
    """Width and height, px; even."""
    noise: float = 0.0
    """Tracker errors: 0 is the truth, 1 what monocular trackers do on real clips."""
    background: Literal["plain", "busy"] = "plain"
    """What is behind the person: a wall, or a room out of focus."""
    seed: int = 0
    """Of the performance and of the tracker's errors."""
    overwrite: bool = False
    """Replace the files of an earlier demo in the same folder."""


def main(arguments: list[str] | None = None) -> int:
    """Entry point of `ggavatar-demo`; returns the exit code."""
    answer_version("ggavatar-demo", arguments)
    options = tyro.cli(Options, args=arguments, prog="ggavatar-demo", description=Options.__doc__)
    return run_command(lambda: _write(options))


def _check(options: Options) -> None:
    if options.frames < 1 or options.frames > 99_999:
        raise InputError(f"expected --frames from 1 to 99999, found {options.frames}")
    if options.size < 32 or options.size > 4096 or options.size % 2:
        raise InputError(f"expected an even --size from 32 to 4096 px, found {options.size}")
    if not 0 <= options.noise <= 10:
        raise InputError(f"expected --noise from 0 (exact) to 10; 1 is realistic; found {options.noise}")
    if options.seed < 0:
        raise InputError(f"expected --seed of 0 or more, found {options.seed}")


def _write(options: Options) -> None:
    _check(options)
    from preprocess.synthetic.demo import Settings, write_demo
    from preprocess.synthetic.output_folder import prepare_demo_folder

    prepare_demo_folder(options.output_dir, overwrite=options.overwrite)
    values = asdict(options)
    folder = values.pop("output_dir")
    values.pop("overwrite")
    for _ in _shown(write_demo(folder, Settings(**values)), options.frames):
        pass
    sys.stdout.write(
        f"wrote {folder}\nnext: ggavatar-prep {folder / 'video.mp4'} --tracking {folder / 'tracking'} "
        f"--masks {folder / 'masks'} --head-model {folder / 'head.npz'} --size {options.size} -o capture\n"
    )


def _shown(work: Iterator[int], total: int) -> Iterator[int]:
    """Pass the frame numbers on while showing progress: a bar on a terminal, a line every tenth otherwise."""
    console = Console(stderr=True)
    if console.is_terminal:
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
        with Progress(*columns, console=console) as progress:
            yield from progress.track(work, total=total, description="rendering")
        return
    for index in work:
        if (index + 1) % max(1, total // 10) == 0 or index + 1 == total:
            sys.stderr.write(f"rendered {index + 1} of {total} frames\n")
        yield index
