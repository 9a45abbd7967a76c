"""Renders the frames of a split to disk, from which all metrics, tables and figures are computed."""

from __future__ import annotations

import hashlib
import json
import statistics
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, runtime_checkable
from typing import Protocol as Interface

import numpy as np
import torch

from evaluate.metrics.efficiency import device_of, model_megabytes, peak_memory_megabytes, timed_render, timing
from evaluate.protocols.protocol import GIVEN, Protocol
from evaluate.scoring.frame_files import frame_file, to_8_bit
from evaluate.scoring.ground_truth import GroundTruth, ImageSource
from ggavatar.core import Camera, Drive, Rasterizer
from ggavatar.errors import InputError
from ggavatar.io.images import write_png
from ggavatar.io.json_files import read_json, write_json
from ggavatar.training.run_folder import Run, choose_split

FOLDERS = ("predictions", "ground_truth", "masks")
SUMMARY = "predict.json"

Progress = Callable[[int, int], None]


@runtime_checkable
class FrameReader(Interface):
    """Drives and cameras by source frame number, as in `ggavatar.data.frames.Frames`."""

    def drive(self, number: int) -> Drive:
        """Drive of a frame."""
        ...

    def camera(self, number: int) -> Camera:
        """Camera of a frame, at the capture's size."""
        ...


@runtime_checkable
class Renderable(Interface):
    """The part of `ggavatar.training.run_folder.Run` that prediction needs."""

    @property
    def avatar(self) -> Any:
        """A method's avatar in evaluation mode."""
        ...

    @property
    def rasterize(self) -> Rasterizer:
        """The rasterizer for the avatar's device."""
        ...

    @property
    def capture(self) -> ImageSource:
        """Source of the ground truth."""
        ...

    @property
    def reader(self) -> FrameReader:
        """Drives and cameras of the source frames."""
        ...


@dataclass(frozen=True)
class PredictionTask:
    """What to predict, and what identifies files of an earlier call as reusable.

    Attributes:
        frames: Source frame numbers in rendering order.
        truth: Background and size of predictions and ground truth.
        identity: Plain values that must match for existing files to be reused: method, step, split and so on.
    """

    frames: tuple[int, ...]
    truth: GroundTruth
    identity: dict[str, Any]

    def described(self) -> dict[str, Any]:
        """All fields as plain JSON values."""
        size = list(self.truth.size) if self.truth.size else None
        content = {"background": list(self.truth.background), "size": size, "binary_mask": self.truth.binary_mask}
        return {**content, "frames": sorted(self.frames), "identity": self.identity}

    def key(self) -> str:
        """SHA-256 of `described` as JSON with sorted keys."""
        return hashlib.sha256(json.dumps(self.described(), sort_keys=True, allow_nan=False).encode()).hexdigest()


def prediction_task(run: Run, protocol: Protocol) -> PredictionTask:
    """The prediction task of a protocol for a run.

    Raises:
        InputError: The run was trained on test frames of the protocol, or the capture lacks the split.
    """
    own = protocol.split in (GIVEN, run.config.split)
    frames = run.split.test if own else choose_split(run.capture, protocol.split)[1].test
    leaked = sorted(set(frames) & set(run.split.train))
    if leaked:
        raise InputError(
            f"{run.folder}: expected a run that has not seen the test frames of {protocol.split}, found {len(leaked)} "
            f"of {len(frames)} (first {leaked[0]}) among its training frames (split {run.config.split}); train with "
            f"--split {protocol.split}, or score with the split it was trained with"
        )
    red, green, blue = run.background.tolist() if protocol.background_rgb is None else protocol.background_rgb
    truth = GroundTruth((red, green, blue), protocol.size, protocol.mask == "binary")
    identity = {
        "subject": run.capture.subject,
        "method": run.method,
        "step": run.step,
        "checkpoint_sha256": _digest(run),
        "split": run.config.split if own else protocol.split,
        "fps": run.capture.fps,
    }
    return PredictionTask(tuple(frames), truth, identity)


def _digest(run: Run) -> str:
    """SHA-256 of the checkpoint, or of the file opened in place of a run."""
    if "file_sha256" in run.provenance:
        return str(run.provenance["file_sha256"])
    return str(read_json(run.folder / "checkpoints" / f"step-{run.step:09d}.json")["sha256"])


def predict_frames(
    run: Renderable, task: PredictionTask, folder: Path, progress: Progress | None = None
) -> dict[str, Any]:
    """Write `predictions/`, `ground_truth/` and `masks/` as 8-bit PNG named by source frame number, and `predict.json`.

    Files of an earlier call for the same task are kept, so an interrupted call resumes.

    Args:
        run: The opened run.
        task: Frames, background and identity.
        folder: Output folder; created if missing.
        progress: Called with (done, total) before the first and after every frame.

    Returns:
        The content of `predict.json`: frames, number of Gaussians, model size, timing and peak memory.

    Raises:
        InputError: The folder contains other images than predictions of this task, or the task has no frames.
    """
    if not task.frames:
        raise InputError("expected at least one frame to render, found none; choose another split or protocol")
    summary = _claim_folder(folder, task)
    missing = [frame for frame in task.frames if not _is_done(folder, frame)]
    done = len(task.frames) - len(missing)
    report = progress or (lambda done, total: None)
    report(done, len(task.frames))
    seconds: list[float] = []
    counts: list[int] = []
    for number in missing:
        image, mask = task.truth.image_and_mask(run.capture, number)
        view = run.reader.drive(number), run.reader.camera(number).resized(image.shape[1], image.shape[0])
        rendering, gaussians, elapsed = timed_render(run.avatar, run.rasterize, view, task.truth.background)
        prediction = to_8_bit(rendering.image.float().cpu().numpy())
        _write_frame(folder, number, (prediction, image, mask))
        seconds.append(elapsed)
        counts.append(gaussians.means.shape[0])
        report(done + len(seconds), len(task.frames))
    if missing or not summary["complete"]:
        summary = {**summary, **_measured(run.avatar, seconds, counts), "complete": True}
        write_json(folder / SUMMARY, summary)
    return summary


def _write_frame(folder: Path, number: int, images: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    for name, image in zip(FOLDERS, images, strict=True):
        write_png(frame_file(folder / name, number), image)


def _is_done(folder: Path, frame: int) -> bool:
    return all(frame_file(folder / name, frame).is_file() for name in FOLDERS)


def _claim_folder(folder: Path, task: PredictionTask) -> dict[str, Any]:
    """Start a summary in the folder, or return the one of an earlier call for this task."""
    path = folder / SUMMARY
    if path.is_file():
        return _read_summary(path, task)
    if folder.is_dir() and any((folder / name).exists() for name in FOLDERS):
        raise InputError(
            f"{folder}: expected no images, found some of unknown origin (no {SUMMARY}); choose another -o"
        )
    summary: dict[str, Any] = {
        "schema": "ggavatar-predictions",
        "version": 1,
        "key": task.key(),
        **task.described(),
        "complete": False,
    }
    write_json(folder / SUMMARY, summary)
    return summary


def _read_summary(path: Path, task: PredictionTask) -> dict[str, Any]:
    """The summary at `path`; `InputError` if it was written for another task."""
    try:
        summary = read_json(path)
        key, complete = summary["key"], bool(summary["complete"])
    except (InputError, KeyError) as error:
        raise InputError(
            f"{path}: expected a summary of predictions, found something else ({error}); choose another -o"
        ) from error
    if key != task.key():
        wanted = task.described()
        changed = [name for name, value in wanted.items() if summary.get(name) != value]
        raise InputError(
            f"{path.parent}: contains predictions that differ from those requested in "
            f"{', '.join(changed) or 'their key'} "
            f"(found {[summary.get(name) for name in changed][:3]}); choose another -o or delete the folder"
        )
    return {**summary, "complete": complete}


def _measured(avatar: torch.nn.Module, seconds: list[float], counts: list[int]) -> dict[str, Any]:
    """Costs; timing and counts only if this call rendered enough frames."""
    device = device_of(avatar)
    found: dict[str, Any] = {
        "model_megabytes": model_megabytes(avatar),
        "peak_memory_megabytes": peak_memory_megabytes(device),
    }
    if counts:
        found["gaussians"] = {"median": int(statistics.median(counts)), "max": max(counts)}
    if len(seconds) > 1:
        found["timing"] = timing(seconds[1:], device)
    return found
