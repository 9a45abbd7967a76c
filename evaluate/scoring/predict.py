"""Render the frames of a split to disk: what every metric, table and figure is computed from."""

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
from jaxtyping import Float
from torch import Tensor

from evaluate.metrics.efficiency import device_of, model_megabytes, peak_memory_megabytes, timed_render, timing
from evaluate.protocols.protocol import GIVEN, Protocol
from evaluate.scoring.frame_files import frame_file, to_8_bit
from evaluate.scoring.ground_truth import ImageSource
from ggavatar.core import Camera, Drive, Rasterizer
from ggavatar.errors import InputError
from ggavatar.io.atomic import write_atomically
from ggavatar.io.images import write_png
from ggavatar.training.run_folder import Run, choose_split, open_run

FOLDERS = ("predictions", "ground_truth", "masks")
SUMMARY = "predict.json"

Progress = Callable[[int, int], None]


@runtime_checkable
class FrameReader(Interface):
    """Drives and cameras by source frame number, as `ggavatar.data.frames.Frames` has them."""

    def drive(self, number: int) -> Drive:
        """What moves the head."""
        ...

    def camera(self, number: int) -> Camera:
        """Where it is seen from, at the capture's size."""
        ...


@runtime_checkable
class Renderable(Interface):
    """The part of `ggavatar.training.run_folder.Run` that predicting needs."""

    @property
    def avatar(self) -> Any:
        """A method's avatar in evaluation mode."""
        ...

    @property
    def rasterize(self) -> Rasterizer:
        """The renderer for its device."""
        ...

    @property
    def capture(self) -> ImageSource:
        """Where the ground truth comes from."""
        ...

    @property
    def reader(self) -> FrameReader:
        """What moves and sees the head in each source frame."""
        ...


@dataclass(frozen=True)
class PredictionTask:
    """What to predict, and what makes files of an earlier call reusable.

    Attributes:
        frames: Source frame numbers, in the order to render.
        truth: Background and size of render and ground truth.
        identity: Plain values that must be equal for existing files to count as done: method, step, protocol.
    """

    frames: tuple[int, ...]
    truth: GroundTruth
    identity: dict[str, Any]

    def described(self) -> dict[str, Any]:
        """Everything as plain JSON values."""
        size = list(self.truth.size) if self.truth.size else None
        content = {"background": list(self.truth.background), "size": size, "binary_mask": self.truth.binary_mask}
        return {**content, "frames": sorted(self.frames), "identity": self.identity}

    def key(self) -> str:
        """SHA-256 of `described` as JSON with sorted keys."""
        return hashlib.sha256(json.dumps(self.described(), sort_keys=True, allow_nan=False).encode()).hexdigest()


def predict(
    run_folder: Path | str,
    protocol: Protocol,
    folder: Path,
    device: str = "cpu",
    step: int | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Render the test frames of a protocol with a trained run; see `predict_frames` for what is written.

    Args:
        run_folder: Written by ggavatar-train.
        protocol: Its split, background, mask and resolution decide the pictures; what is `given` follows the run.
        folder: Where to write.
        device: Where to draw.
        step: Which checkpoint; None is the newest.
        progress: Called with (done, total).

    Raises:
        InputError: Not a run, a split the capture does not have, or test frames that the run was trained on.
    """
    run = open_run(run_folder, device, step)
    return predict_frames(run, prediction_task(run, protocol), folder, progress)


def prediction_task(run: Run, protocol: Protocol) -> PredictionTask:
    """What a protocol asks of a run; `InputError` if the run was trained on frames that the protocol tests."""
    own = protocol.split in (GIVEN, run.config.split)
    frames = run.split.test if own else choose_split(run.capture, protocol.split)[1].test
    leaked = sorted(set(frames) & set(run.split.train))
    if leaked:
        raise InputError(
            f"{run.folder}: expected a run that has not seen the test frames of {protocol.split}, found {len(leaked)} "
            f"of {len(frames)} (first {leaked[0]}) among its training frames (split {run.config.split}); train with "
            f"--split {protocol.split}, or score with the split it was trained for"
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
    """SHA-256 of the checkpoint, or of the file that was opened in place of a run."""
    if "file_sha256" in run.provenance:
        return str(run.provenance["file_sha256"])
    record = run.folder / "checkpoints" / f"step-{run.step:09d}.json"
    return str(json.loads(record.read_text(encoding="utf-8"))["sha256"])


def predict_frames(
    run: Renderable, job: PredictionTask, folder: Path, progress: Progress | None = None
) -> dict[str, Any]:
    """Write `predictions/`, `ground_truth/` and `masks/` as 8-bit PNG named by source frame number, and `predict.json`.

    Files of an earlier call for the same job are kept, so an interrupted call continues where it was.

    Args:
        run: The opened run.
        job: Frames, background and identity.
        folder: Where to write; made if missing.
        progress: Called with (done, total) before the first and after every frame.

    Returns:
        The content of `predict.json`: frames, number of Gaussians, model size, timing and peak memory.

    Raises:
        InputError: If the folder holds anything but predictions of this job, or the job has no frames.
    """
    if not job.frames:
        raise InputError("expected at least one frame to render, found none; choose another split or protocol")
    summary = _claimed(folder, job)
    missing = [frame for frame in job.frames if not _done(folder, frame)]
    done = len(job.frames) - len(missing)
    report = progress or (lambda done, total: None)
    report(done, len(job.frames))
    seconds: list[float] = []
    counts: list[int] = []
    for number in missing:
        image, mask = job.truth.of(run.capture, number)
        view = run.reader.drive(number), run.reader.camera(number).resized(image.shape[1], image.shape[0])
        rendering, gaussians, elapsed = timed_render(run.avatar, run.rasterize, view, job.truth.background)
        _write_frame(folder, number, (pixels_of(rendering.image), image, mask))
        seconds.append(elapsed)
        counts.append(gaussians.means.shape[0])
        report(done + len(seconds), len(job.frames))
    if missing or not summary["complete"]:
        summary = {**summary, **_measured(run.avatar, seconds, counts), "complete": True}
        _write_summary(folder, summary)
    return summary


def pixels_of(image: Float[Tensor, "H W C"]) -> np.ndarray:
    """A picture in [0, 1] as 8-bit pixels on the host; a single channel loses its axis."""
    pixels = to_8_bit(image.detach().float().cpu().numpy())
    return pixels[..., 0] if pixels.shape[-1] == 1 else pixels


def _write_frame(folder: Path, number: int, pictures: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    for name, picture in zip(FOLDERS, pictures, strict=True):
        write_png(frame_file(folder / name, number), picture)


def _done(folder: Path, frame: int) -> bool:
    return all(frame_file(folder / name, frame).is_file() for name in FOLDERS)


def _claimed(folder: Path, job: PredictionTask) -> dict[str, Any]:
    """Make the folder ours, or check that it already is, and return its summary so far."""
    path = folder / SUMMARY
    if path.is_file():
        return _matching(path, job)
    if folder.is_dir() and any((folder / name).exists() for name in FOLDERS):
        raise InputError(
            f"{folder}: expected no pictures, found some of unknown origin (no {SUMMARY}); choose another -o"
        )
    summary: dict[str, Any] = {
        "schema": "ggavatar-predictions",
        "version": 1,
        "key": job.key(),
        **job.described(),
        "complete": False,
    }
    _write_summary(folder, summary)
    return summary


def _matching(path: Path, job: PredictionTask) -> dict[str, Any]:
    """The summary at `path`, if it was written for this job."""
    try:
        summary = json.loads(path.read_text(encoding="utf-8"))
        key, complete = summary["key"], bool(summary["complete"])
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{path}: expected a summary of predictions, found something else ({error!r}); choose another -o"
        ) from error
    if key != job.key():
        wanted = job.described()
        changed = [name for name, value in wanted.items() if summary.get(name) != value]
        raise InputError(
            f"{path.parent}: holds predictions that differ from those asked for in {', '.join(changed) or 'their key'} "
            f"(found {[summary.get(name) for name in changed][:3]}); choose another -o or delete the folder"
        )
    return {**summary, "complete": complete}


def _measured(avatar: torch.nn.Module, seconds: list[float], counts: list[int]) -> dict[str, Any]:
    """Costs; timing and counts only where this call rendered enough to tell."""
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


def _write_summary(folder: Path, summary: dict[str, Any]) -> None:
    text = json.dumps(summary, indent=2, allow_nan=False) + "\n"
    write_atomically(folder / SUMMARY, lambda stream: stream.write(text.encode()))
