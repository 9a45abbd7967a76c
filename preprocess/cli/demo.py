"""`ggavatar-demo`: a generated, license-free person as a user's data: video, mattes, tracker files, head model."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from ggavatar.cli.page import CommandPage, parse
from ggavatar.cli.progress import announce_start, show_progress
from ggavatar.cli.run import run_command
from ggavatar.text.terminal import write_out
from preprocess.synthetic.settings import DemoSettings, check_settings

HEAD_BYTES, FRAME_BYTES = 1_000_000, 4_000
"""The head model, and mask, tracking and video of a frame of the smallest size that shows a person."""


@dataclass(frozen=True)
class DemoOptions:
    """Write a generated person: video.mp4, masks/, tracking/, head.npz and truth.npz."""

    output_dir: Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="DIR")]
    """Folder to write; must be new or empty unless --overwrite is given."""
    identity: Annotated[Literal[1, 2, 3, 4, 5], tyro.conf.arg(name="id")] = 1
    """Which of the five people to write."""
    frames: int = 600
    """Number of frames, at 25 frames per second."""
    size: int = 512
    """Width and height of the video, px; even."""
    noise: float = 0.0
    """Level of simulated tracker errors: 0 is the ground truth, 1 is typical of monocular trackers on real clips."""
    background: Literal["plain", "busy"] = "plain"
    """Background: a plain wall, or a busy room out of focus."""
    seed: int = 0
    """Seed of the performance and of the tracker errors."""
    overwrite: bool = False
    """Replace the files of an earlier demo in the same folder."""


PAGE = CommandPage(
    program="ggavatar-demo",
    options=DemoOptions,
    summary="Write a generated, license-free person as a user's data: video, masks, tracking, head model and truth.",
    examples=(
        ("ggavatar-demo -o demo --frames 120 --size 256", "a short clip, to try the other commands with"),
        ("ggavatar-demo -o demo --id 3 --background busy", "another person, in a room"),
        ("ggavatar-demo -o demo --noise 1", "with tracking as monocular trackers give it"),
    ),
    groups={
        "who and what": ("output_dir", "identity", "frames", "size", "background"),
        "tracking": ("noise", "seed"),
        "an earlier demo in the folder": ("overwrite",),
    },
)


def main(arguments: list[str] | None = None) -> int:
    """Entry point of `ggavatar-demo`; returns the exit code."""
    return run_command(lambda: _write(parse(PAGE, arguments)), DemoOptions)


def _write(options: DemoOptions) -> None:
    values = asdict(options)
    folder, overwrite = values.pop("output_dir"), values.pop("overwrite")
    settings = DemoSettings(**values)
    check_settings(settings)
    announce_start()
    from ggavatar.io.folder_lock import lock_folder
    from ggavatar.io.free_space import require_space
    from ggavatar.io.held_folders import make_folder
    from preprocess.synthetic.demo import write_demo
    from preprocess.synthetic.output_folder import check_demo_folder, prepare_demo_folder

    check_demo_folder(folder, overwrite=overwrite)
    require_space(folder, HEAD_BYTES + FRAME_BYTES * options.frames)
    make_folder(folder)
    with lock_folder(folder):
        prepare_demo_folder(folder, overwrite=overwrite)
        with show_progress("rendering") as show:
            for index in write_demo(folder, settings):
                show(index + 1, options.frames)
    write_out(
        f"wrote {folder}",
        f"next: ggavatar-prep {folder / 'video.mp4'} --tracking {folder / 'tracking'} "
        f"--masks {folder / 'masks'} --head-model {folder / 'head.npz'} --size {options.size} -o capture",
    )
