"""Renders the frames of a split to disk, from which all metrics, tables and figures are computed."""

from __future__ import annotations

import dataclasses
import statistics
from pathlib import Path
from typing import Any, runtime_checkable
from typing import Protocol as Interface

import torch

from evaluate.metrics.efficiency import device_of, model_megabytes, peak_memory_megabytes, timed_render, timing
from evaluate.protocols.protocol import Protocol
from evaluate.scoring.frame_files import frame_file
from evaluate.scoring.frame_store import FOLDERS, SUMMARY, Filled, PredictionTask, Progress, fill_frames
from evaluate.scoring.ground_truth import ImageSource
from evaluate.scoring.region_masks import FrameReader
from evaluate.scoring.scored_frames import ScoredFrames, choose_frames, ground_truth_of
from ggavatar.core import Rasterizer
from ggavatar.errors import InputError
from ggavatar.io.images import write_png
from ggavatar.io.json_files import write_sealed_json
from ggavatar.pictures.quantization import to_8_bit
from ggavatar.training.run_folder import Run


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


def prediction_task(run: Run, protocol: Protocol, rule: str | None = None) -> PredictionTask:
    """The prediction task of a protocol for a run.

    Args:
        run: The opened run.
        protocol: Names the split.
        rule: `file:PATH` if the protocol's split is a list in a file.

    Raises:
        InputError: The run was trained on test frames of the protocol, or the capture lacks the split.
    """
    chosen = choose_frames(run.capture, protocol, rule, ScoredFrames(run.config.split, run.split.test))
    leaked = sorted(set(chosen.frames) & set(run.split.train))
    if leaked:
        raise InputError(
            f"{run.folder}: expected a run that has not seen the test frames of {chosen.split}, found {len(leaked)} "
            f"of {len(chosen.frames)} (first {leaked[0]}) among its training frames (split {run.config.split}); train "
            f"with --split {chosen.split}, or score with the split it was trained with"
        )
    red, green, blue = run.background.tolist()
    truth = ground_truth_of(protocol, (red, green, blue))
    identity = {
        "subject": run.capture.subject,
        "method": run.method,
        "step": run.step,
        "checkpoint_sha256": run.sha256,
        "capture_sha256": run.capture.digest(),
        "split": chosen.split,
        "fps": run.capture.fps,
    }
    return PredictionTask(chosen.frames, truth, identity)


def predict_frames(run: Renderable, task: PredictionTask, folder: Path, progress: Progress | None = None) -> Filled:
    """Write `predictions/`, `ground_truth/` and `masks/` as 8-bit PNG named by source frame number, and `predict.json`.

    Files of an earlier call for the same task are kept if their digests still match, so an interrupted call resumes.

    Args:
        run: The opened run.
        task: Frames, background and identity.
        folder: Output folder; created if missing.
        progress: Called with (done, total) before the first and after every frame.

    Returns:
        What was written; the summary has frames, number of Gaussians, model size, timing and peak memory.

    Raises:
        InputError: The folder contains other images than predictions of this task, or the task has no frames.
    """
    seconds: list[float] = []
    counts: list[int] = []

    def render(number: int, size: tuple[int, int]) -> Path:
        view = run.reader.drive(number), run.reader.camera(number).resized(*size)
        rendering, gaussians, elapsed = timed_render(run.avatar, run.rasterize, view, task.truth.background)
        seconds.append(elapsed)
        counts.append(gaussians.means.shape[0])
        path = frame_file(folder / FOLDERS[0], number)
        write_png(path, to_8_bit(rendering.image.float().cpu().numpy()))
        return path

    filled = fill_frames(folder, task, run.capture, render, progress=progress)
    if not filled.written and filled.summary["complete"]:
        return filled
    summary = {**filled.summary, **_measured(run.avatar, seconds, counts), "complete": True}
    write_sealed_json(folder / SUMMARY, summary)
    return dataclasses.replace(filled, summary=summary)


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
