"""The run folder: written by a training, opened by evaluation, rendering, export and resuming.

run/
  config.json        everything that decides the training, plain data
  provenance.json    versions, command line, device, digests, time and memory
  split.json         the frames trained on and tested on
  checkpoints/       step-000006000.safetensors and .json
  metrics/           train.jsonl, eval.jsonl
  snapshot.safetensors   the avatar as it is, while a viewer follows the training
"""

from __future__ import annotations

import contextlib
import dataclasses
import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from ggavatar.core import Frame, Rasterizer
from ggavatar.data.capture import Capture
from ggavatar.data.frames import Frames, evenly_spaced
from ggavatar.data.scene import Scene
from ggavatar.data.splits import Split, split_frames, split_name
from ggavatar.errors import InputError
from ggavatar.head.files import load_head
from ggavatar.head.model import HeadModel
from ggavatar.io.atomic import is_partial, remove_partial_files
from ggavatar.io.dataclass_json import from_plain, to_plain
from ggavatar.io.folder_lock import is_lock_file, lock_folder
from ggavatar.io.held_folders import make_folder
from ggavatar.io.json_files import read_json, write_sealed_json
from ggavatar.training import registry
from ggavatar.training.build_budget import BuildTooLargeError, within_budget
from ggavatar.training.checkpoint import has_checkpoint, load_checkpoint, unpack_avatar
from ggavatar.training.plan import TrainingPlan
from ggavatar.training.snapshot import SNAPSHOT

SCHEMA, VERSION = "ggavatar-run", 1
BESIDE_THE_CONFIGURATION = ("schema", "version", "capture_relative", "settings")
"""Entries of config.json that are no fields of `RunConfig`; runs of earlier builds hold `settings`, which can be
worked out (`changed_settings.py`)."""
SAMPLE_COUNT, SAMPLE_SIDE = 16, 256
"""Training frames that a method sees before the first step, and the length of their shorter side, px."""


@dataclass(frozen=True)
class RunConfig:
    """The configuration of a training, as in config.json; together with the capture it determines the result."""

    method: str
    """Command-line name of the method or variant."""
    capture: str
    """Folder of the capture, absolute."""
    split: str = "every-20th"
    """Name of the split in capture.json, or the rule that made it."""
    background: tuple[float, ...] = (1.0, 1.0, 1.0)
    """sRGB in [0, 1]."""
    seed: int = 42
    """Seed of all random numbers."""
    device: str = "cpu"
    """Device of the training."""
    backend: str = "auto"
    """The rasterizer, as in `ggavatar.render.backends`."""
    preset: str = "default"
    """The preset that the other values were derived from."""
    training: TrainingPlan = field(default_factory=TrainingPlan)
    """Settings of the training loop."""
    method_config: dict[str, Any] = field(default_factory=dict)
    """Every setting of the method."""

    @property
    def perceptual_features(self) -> Any:
        """What the perceptual loss is asked to compare, as in `method_config`; None if there is no such loss."""
        settings = self.method_config
        return settings.get("perceptual_features") if settings.get("perceptual_weight") else None


@dataclass(frozen=True)
class Run:
    """A trained avatar with all that is needed to render and evaluate it.

    Attributes:
        folder: The run folder.
        method: Command-line name of its method.
        avatar: In evaluation mode, on the requested device.
        capture: The capture it was trained on.
        head: The head model of the capture, on the device of the avatar.
        split: Frames trained on and tested on.
        background: Color it was trained on, sRGB.
        rasterize: The renderer for the device.
        config: config.json.
        provenance: provenance.json.
        step: Steps trained.
        sha256: Of the tensors of its checkpoint, or of the file that was opened in place of a run.
        reader: Reads the frames of the capture.
    """

    folder: Path
    method: str
    avatar: Any
    capture: Capture
    head: HeadModel
    split: Split
    background: Tensor
    rasterize: Rasterizer
    config: RunConfig
    provenance: dict[str, Any]
    step: int
    sha256: str
    reader: Frames

    def __repr__(self) -> str:
        """Method, steps, subject and folder."""
        return f"Run({self.method!r}, {self.step} steps, subject {self.capture.subject!r}, {str(self.folder)!r})"

    def frames(self, numbers: Iterable[int]) -> Iterator[Frame]:
        """Frames by source number, at the capture's size, composited on the run's background; reads a few ahead."""
        size = (self.capture.width, self.capture.height)
        yield from self.reader.stream((number, *size) for number in numbers)


def open_run(
    folder: Path | str,
    device: str = "cpu",
    step: int | None = None,
    backend: str = "auto",
    capture: Path | str | None = None,
) -> Run:
    """Open a run folder.

    Args:
        folder: The run.
        device: Device of the avatar.
        step: Step of the checkpoint; None is the newest complete one.
        backend: The rasterizer, as in `ggavatar.render.backends`.
        capture: New location of the capture, if it was moved.

    Raises:
        InputError: The folder is not a run, its capture is not found, or there is no such checkpoint.
    """
    folder = Path(folder)
    config = read_config(folder)
    opened = Capture.open(capture or find_capture(folder, config))
    tensors, record = load_checkpoint(folder / "checkpoints", step)
    return run_with_tensors(folder, opened, tensors, (record["step"], record["sha256"]), device, backend)


def run_with_tensors(
    folder: Path, opened: Capture, tensors: Mapping[str, Tensor], origin: tuple[int, str], device: str, backend: str
) -> Run:
    """The run of a folder with an avatar from tensors that have been read.

    Args:
        folder: The run.
        opened: Its capture.
        tensors: The avatar's part of a checkpoint or a snapshot.
        origin: Step and SHA-256 of the tensors, or what they are instead of a checkpoint.
        device: Device of the avatar.
        backend: The rasterizer.

    Raises:
        InputError: The folder's files or the tensors do not fit together.
    """
    step, sha256 = origin
    stored = StoredAvatar(read_config(folder), opened, load_head(opened.head_path), read_split(folder), tensors, step)
    provenance = _read_run_file(folder / "provenance.json")
    try:
        return assembled_run(folder, stored, device, backend, provenance, sha256)
    except BuildTooLargeError as error:
        raise InputError(
            f"{folder / 'config.json'}: expected settings of the checkpoint that is there, found {error}; use the "
            "config.json that ggavatar-train wrote"
        ) from error


@dataclass(frozen=True)
class StoredAvatar:
    """What an avatar is built from again, wherever it was stored.

    Attributes:
        config: Of its training.
        capture: Its tracking; images are not needed.
        head: The head model.
        split: Frames trained on and tested on.
        tensors: The avatar's part of a checkpoint.
        step: Steps trained.
    """

    config: RunConfig
    capture: Capture
    head: HeadModel
    split: Split
    tensors: Mapping[str, Tensor]
    step: int


def assembled_run(
    folder: Path, stored: StoredAvatar, device: str, backend: str, provenance: dict[str, Any], sha256: str
) -> Run:
    """A run from its parts.

    Raises:
        InputError: They do not fit together.
        BuildTooLargeError: The settings ask for more memory than the tensors justify.
    """
    config, capture = stored.config, stored.capture
    scene, reader = make_scene(config, capture, stored.split, device, head=stored.head)
    method = registry.load_as_trained(config.method, provenance.get("method_package"), folder)
    settings = method.config_from(config.method_config, f"{folder}: method_config")
    avatar = within_budget(stored.tensors.values(), lambda: method.build(settings, scene))
    unpack_avatar(avatar, stored.tensors)
    return Run(
        folder=folder,
        method=config.method,
        avatar=avatar.eval(),
        capture=capture,
        head=scene.head,
        split=stored.split,
        background=scene.background,
        rasterize=method.rasterizer(device, backend),
        config=config,
        provenance=provenance,
        step=stored.step,
        sha256=sha256,
        reader=reader,
    )


def make_scene(
    config: RunConfig,
    capture: Capture,
    split: Split,
    device: str,
    rasterize: Rasterizer | None = None,
    head: HeadModel | None = None,
) -> tuple[Scene, Frames]:
    """The scene a method is built from, and the reader of its frames.

    Args:
        config: Of the run.
        capture: Of the run.
        split: Frames to train on and to test on.
        device: Device of the tensors.
        rasterize: The renderer, for a new training; None for a trained avatar, whose scene needs no sample frames.
        head: The head model; None reads that of the capture.
    """
    head = (head or load_head(capture.head_path)).to(device, torch.float32)
    background = torch.tensor(config.background, device=device)
    reader = Frames(capture, head, background, device, config.training.cache_mib)
    samples: tuple[Frame, ...] = ()
    if rasterize is not None:
        factor = min(1.0, SAMPLE_SIDE / min(capture.width, capture.height))
        size = (round(capture.width * factor), round(capture.height * factor))
        samples = tuple(reader.frame(number, *size) for number in evenly_spaced(split.train, SAMPLE_COUNT))
    scene = Scene(
        head=head,
        drives=tuple(reader.drive(number) for number in split.train),
        cameras=tuple(reader.camera(number) for number in split.train),
        background=background,
        steps=config.training.steps,
        seed=config.seed,
        max_gaussians=config.training.max_gaussians,
        samples=samples,
        rasterize=rasterize,
    )
    return scene, reader


def check_run_folder(folder: Path, overwrite: bool) -> None:
    """Check that a new run may be written into a folder; nothing is changed.

    Raises:
        InputError: The folder holds a run that has a checkpoint or results and `overwrite` is not set, or it holds
            other files, or it is a file.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: expected a folder for the run, found a file; choose another folder with -o")
    foreign = _foreign_files(folder) if folder.exists() else []
    if not holds_run(folder):
        if foreign:
            raise InputError(
                f"{folder}: expected an empty folder or a run, found other files ({foreign[0].name}); choose another "
                "folder with -o"
            )
    else:
        # Without a checkpoint, resuming would begin with the first step too: there is nothing to keep.
        if not overwrite and (foreign or has_checkpoint(folder / "checkpoints")):
            raise InputError(
                f"{folder}: already holds a run; pass --resume to continue it, --overwrite to replace it, or choose "
                "another folder with -o"
            )
        read_config(folder)  # raises if config.json belongs to another program


def holds_run(folder: Path) -> bool:
    """Whether a training has begun in a folder, so that it can be resumed."""
    return (folder / "config.json").exists()


def _foreign_files(folder: Path) -> list[Path]:
    """What is in a folder besides what a training leaves there that was stopped before its first checkpoint."""
    own = {"checkpoints", "config.json", "metrics", "split.json", "provenance.json", SNAPSHOT}
    others = (path for path in folder.iterdir() if path.name not in own)
    return sorted(path for path in others if not is_partial(path) and not is_lock_file(path))


def create_run_folder(folder: Path, overwrite: bool) -> None:
    """Create the folder of a new run, and remove the run that is in it.

    Raises:
        InputError: As in `check_run_folder`.
    """
    check_run_folder(folder, overwrite)
    _remove_own_files(folder)
    for name in ("checkpoints", "metrics"):
        make_folder(folder / name)


def remove_leftovers(folder: Path) -> None:
    """Remove the temporary files and the snapshot that a killed training has left."""
    (folder / SNAPSHOT).unlink(missing_ok=True)
    remove_partial_files(folder, folder / "checkpoints", folder / "metrics")


def _remove_own_files(folder: Path) -> None:
    """Remove what a training wrote, file by file; nothing else in the folder is touched."""
    own = [
        *folder.glob("checkpoints/step-*.json"),
        *folder.glob("checkpoints/step-*.safetensors"),
        *folder.glob("metrics/*.jsonl"),
    ]
    for path in [*own, *(folder / name for name in ("config.json", "provenance.json", "split.json", SNAPSHOT))]:
        path.unlink(missing_ok=True)
    remove_leftovers(folder)


def remove_run(folder: Path) -> None:
    """Remove a run that nobody needs any more; what somebody else put into its folder stays, and the folder with it.

    Raises:
        InputError: Another process is writing into it.
    """
    if not folder.is_dir():
        return
    with lock_folder(folder):
        _remove_own_files(folder)
    for path in (folder / "checkpoints", folder / "metrics", folder):
        with contextlib.suppress(OSError):  # not there, or not empty
            path.rmdir()


def write_config(folder: Path, config: RunConfig, split: Split) -> None:
    """Write config.json and split.json."""
    capture = Path(config.capture)
    try:
        relative = os.path.relpath(capture, folder.resolve())
    except ValueError:  # on another drive of Windows
        relative = ""
    lists = {"train": list(split.train), "test": list(split.test)}
    write_sealed_json(folder / "split.json", {"name": config.split, **lists})
    write_sealed_json(
        folder / "config.json", {"schema": SCHEMA, "version": VERSION, "capture_relative": relative, **to_plain(config)}
    )


def read_config(folder: Path) -> RunConfig:
    """Read config.json.

    Raises:
        InputError: The folder is not a run, its version is not supported, or the file is damaged.
    """
    path = folder / "config.json"
    if not path.exists():
        found = "no config.json in it" if folder.is_dir() else "no such folder"
        capture = "; it is a capture: train on it first" if (folder / "capture.json").exists() else ""
        raise InputError(f"{folder}: expected a run folder written by ggavatar-train, found {found}{capture}")
    values = _read_run_file(path)
    if values.get("schema") != SCHEMA or values.get("version") != VERSION:
        raise InputError(
            f"{path}: expected schema {SCHEMA} version {VERSION}, found {values.get('schema')} {values.get('version')}"
        )
    own = {name: value for name, value in values.items() if name not in BESIDE_THE_CONFIGURATION}
    missing = [f.name for f in dataclasses.fields(RunConfig) if f.default is f.default_factory and f.name not in own]
    if missing:
        raise InputError(f"{path}: expected the fields {', '.join(missing)}, found none; the file is damaged")
    return from_plain(RunConfig, own, str(path))


def capture_places(folder: Path, config: RunConfig) -> list[Path]:
    """Where the capture of a run may be: at its path relative to the run, then where it was when the training began.

    The relative path comes first, so that a copy of both works with its own capture, whatever became of the original.
    """
    relative = _read_run_file(folder / "config.json").get("capture_relative")
    beside = [Path(os.path.normpath(folder.resolve() / relative))] if isinstance(relative, str) and relative else []
    return [*beside, Path(config.capture)]


def find_capture(folder: Path, config: RunConfig) -> Path:
    """The capture of a run, at one of `capture_places`.

    Raises:
        InputError: It is at none of them.
    """
    places = capture_places(folder, config)
    for path in places:
        if (path / "capture.json").exists():
            return path
    raise InputError(
        f"{folder}: expected its capture at {' or '.join(map(str, places))}, found none there; move it back, or name "
        "its new location with --capture"
    )


def choose_split(capture: Capture, rule: str) -> tuple[str, Split]:
    """The name and the frames of a split: one that the capture lists, or else one made by the rule."""
    name = split_name(rule)
    if name in capture.splits and not rule.startswith("file:"):
        return name, capture.splits[name]
    return rule, split_frames(capture.frames, rule)


def read_split(folder: Path) -> Split:
    """Read split.json."""
    path = folder / "split.json"
    values = _read_run_file(path)
    try:
        return Split(tuple(map(int, values["train"])), tuple(map(int, values["test"])))
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: expected lists train and test of frame numbers ({error!r})") from error


def _read_run_file(path: Path) -> dict[str, Any]:
    if not path.exists():
        raise InputError(f"{path}: no such file; the folder is not a complete run")
    return read_json(path)
