"""What is exposed to faults: every command on the smallest subject, and what each of them reads."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from tests.faults.bench import Bench, Surroundings

FRAMES, SIZE, STEPS = 12, 64, 30


@dataclass(frozen=True)
class Task:
    """A command with arguments that suit a case folder.

    Attributes:
        name: Unique; the command and, where there are several of it, what it writes.
        command: Such as `train`.
        arguments: Given what is shared; paths of the output are relative to the case folder.
        prepare: Puts what the command reads and writes into the case folder.
        output: The folder or file that the command fills, below the case folder.
        can_resume: Whether the command has a flag --resume.
    """

    name: str
    command: str
    arguments: Callable[[Bench], tuple[object, ...]]
    prepare: Callable[[Bench, Path], None]
    output: str
    can_resume: bool = False


def must(bench: Bench, command: str, *arguments: object) -> None:
    """Run a command that nothing disturbs."""
    ended = bench.run(command, arguments, Surroundings(bench.folder))
    assert ended.code == 0, f"ggavatar-{command} failed without a fault: {ended.last_words}"


def subject(bench: Bench) -> Path:
    """A generated person: video, tracking, masks, head."""

    def make(folder: Path) -> Path:
        must(bench, "demo", "--frames", FRAMES, "--size", SIZE, "-o", folder)
        return folder

    return bench.once("subject", make)


def prep_arguments(bench: Bench) -> tuple[object, ...]:
    """The arguments of ggavatar-prep for the subject, without the output."""
    source = subject(bench)
    tracking = ("--tracking", source / "tracking", "--masks", source / "masks", "--head-model", source / "head.npz")
    return (source / "video.mp4", *tracking, "--subject", "someone", "--size", SIZE, "--split", "ratio-0.5")


def capture(bench: Bench) -> Path:
    """The subject's capture."""

    def make(folder: Path) -> Path:
        must(bench, "prep", *prep_arguments(bench), "-o", folder)
        return folder

    return bench.once("capture", make)


def train_arguments(bench: Bench) -> tuple[object, ...]:
    """The arguments of a short ggavatar-train, without the output."""
    flags = ("--steps", STEPS, "--save-every", 5, "--split", "ratio-0.5", "--set", "perceptual_weight=0")
    return (capture(bench), "ggavatar", *flags)


def trained(bench: Bench) -> Path:
    """A short training on the capture."""

    def make(folder: Path) -> Path:
        must(bench, "train", *train_arguments(bench), "-o", folder)
        return folder

    return bench.once("run", make)


def nothing(bench: Bench, folder: Path) -> None:
    """For commands that read only what is shared."""


def copy_of_run(bench: Bench, folder: Path) -> None:
    """For commands that write into the run."""
    shutil.copytree(trained(bench), folder / "run")


def _export(kind: str, output: str, *flags: object) -> Task:
    arguments = ("run", "--format", kind, *flags, "-o", output)
    name = "-".join(("export", kind, *([output] if flags else [])))
    return Task(name, "export", lambda bench: arguments, copy_of_run, output)


def _export_capture(kind: str) -> Task:
    return Task(
        f"export-{kind}", "export", lambda bench: (capture(bench), "--format", kind, "-o", "layout"), nothing, "layout"
    )


DEMO = Task("demo", "demo", lambda bench: ("--frames", FRAMES, "--size", SIZE, "-o", "person"), nothing, "person")
PREP = Task("prep", "prep", lambda bench: (*prep_arguments(bench), "-o", "capture"), nothing, "capture", True)
TRAIN = Task("train", "train", lambda bench: (*train_arguments(bench), "-o", "run"), nothing, "run", True)
EVAL = Task("eval", "eval", lambda bench: ("run", "--table", "--no-lpips"), copy_of_run, "run")
RENDER = Task(
    "render", "render", lambda bench: ("run", "--split", "all", "--alpha", "-o", "images"), copy_of_run, "images", True
)
ORBIT = Task(
    "render-orbit", "render", lambda bench: ("run", "--orbit", "--views", 8, "-o", "orbit"), copy_of_run, "orbit", True
)


def _sweep(name: str, *flags: object) -> Task:
    steps = ("--steps", 10, "--set", "perceptual_weight=0")
    return Task(name, "sweep", lambda bench: (capture(bench), *flags, *steps, "-o", "sweep"), nothing, "sweep")


SWEEP = _sweep("sweep", "--seeds", 1, 2)
ONE_CELL = _sweep("sweep-of-one", "--train-only")
EXPORTS = (
    _export("ply", "face.ply"),
    _export("splat", "face.splat"),
    _export("spz", "face.spz"),
    _export("glb", "face.glb"),
    _export("gaussian-avatars", "bound"),
    _export_capture("vhap"),
    _export("ply", "frames", "--frame", 0, 3),
    _export("avatar", "face.ggavatar"),
    _export("web", "face.html"),
)
DOCTOR = Task("doctor", "doctor", lambda bench: (capture(bench),), nothing, "")
MODELS = Task("models", "models", lambda bench: (), nothing, "")
