"""The training loop, which is the same for all methods: a method takes part through `ggavatar.core.Avatar` alone."""

from __future__ import annotations

import math
import signal
import threading
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any

import torch
from torch import Tensor

from ggavatar.core import Frame, Rasterizer, Rendering
from ggavatar.data.frames import Frames, evenly_spaced, random_order
from ggavatar.data.splits import Split
from ggavatar.io.held_folders import make_folder
from ggavatar.training.checkpoint import (
    complete_steps,
    load_checkpoint,
    pack,
    save_checkpoint,
    unpack_avatar,
    unpack_optimizers,
)
from ggavatar.training.journal import Journal
from ggavatar.training.plan import TrainingPlan
from ggavatar.training.progress import Listener


class TrainingError(RuntimeError):
    """The training cannot continue; the last checkpoint is intact."""


class StopSignals:
    """While active, SIGINT (Ctrl-C) and SIGTERM stop the loop after the current step; a second signal stops it at once.

    Attributes:
        received: Number of the signal that was received, or None.
    """

    def __init__(self) -> None:
        self.received: int | None = None
        self._previous: dict[int, Any] = {}

    def __enter__(self) -> StopSignals:
        if threading.current_thread() is threading.main_thread():
            self._previous = {number: signal.signal(number, self._note) for number in (signal.SIGINT, signal.SIGTERM)}
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._previous.items():
            signal.signal(number, handler)

    def _note(self, number: int, _: FrameType | None) -> None:
        if self.received is not None:
            raise KeyboardInterrupt
        self.received = number


@dataclass
class FiniteGuard:
    """Skips steps whose loss or gradient is not finite, and stops the training after too many of them.

    Attributes:
        limit: Number of skipped steps at which the training stops.
        count: Steps skipped so far.
    """

    limit: int
    count: int = 0

    def passes(self, step: int, terms: Mapping[str, Tensor], avatar: torch.nn.Module) -> bool:
        """Whether all loss terms and gradients are finite; call it after the backward pass.

        Raises:
            TrainingError: The limit is reached.
        """
        source = _find_not_finite(terms, avatar)
        if source is None:
            return True
        self.count += 1
        if self.count >= self.limit:
            raise TrainingError(
                f"step {step}: {source} is not finite; this has happened {self.count} times. Common causes: tracking "
                "that puts the head behind the camera or far away (run ggavatar-doctor on the capture), a learning "
                "rate that is too high, an empty mask. Earlier checkpoints are intact."
            )
        return False


def _find_not_finite(terms: Mapping[str, Tensor], avatar: torch.nn.Module) -> str | None:
    for name, value in terms.items():
        if not math.isfinite(value.item()):
            return f"loss term {name!r}"
    gradients = {name: parameter.grad for name, parameter in avatar.named_parameters() if parameter.grad is not None}
    sums = torch.stack([gradient.sum() for gradient in gradients.values()]) if gradients else torch.zeros(0)
    if bool(torch.isfinite(sums).all()):
        return None
    return "the gradient of " + next(
        name for name, total in zip(gradients, sums.tolist(), strict=True) if not math.isfinite(total)
    )


@dataclass
class Trainer:
    """One training, from its avatar to its run folder.

    Attributes:
        avatar: A method's avatar, an `nn.Module`.
        frames: Reads the frames of the capture.
        split: Frames to train on and to test on.
        rasterize: The renderer.
        background: sRGB.
        plan: Length, schedules and intervals.
        seed: Determines the order of the frames.
        folder: The run folder.
        listener: Receives the progress.
        seconds: Training time over all sessions, s.
    """

    avatar: Any
    frames: Frames
    split: Split
    rasterize: Rasterizer
    background: Tensor
    plan: TrainingPlan
    seed: int
    folder: Path
    listener: Listener
    seconds: float = 0.0

    def resume(self) -> int:
        """Load the newest complete checkpoint, if there is one, and return the steps done."""
        checkpoints = self.folder / "checkpoints"
        if not complete_steps(checkpoints):
            return 0
        tensors, record = load_checkpoint(checkpoints)
        unpack_avatar(self.avatar, tensors)
        unpack_optimizers(self.avatar.optimizers(), tensors, record["optimizers"])
        self.seconds = record["seconds"]
        return int(record["step"])

    def run(self, done: int, stop: StopSignals) -> int:
        """Train from step `done` + 1 to the last step or until a signal, save, and return the steps done.

        Raises:
            TrainingError: Losses or gradients are not finite too often.
            OSError: A checkpoint cannot be written.
        """
        guard = FiniteGuard(self.plan.bad_steps)
        for name in ("checkpoints", "metrics"):
            make_folder(self.folder / name)
        train_log, eval_log = (Journal(self.folder / "metrics" / name, done) for name in ("train.jsonl", "eval.jsonl"))
        started, before = time.monotonic(), self.seconds
        saved = done
        stream = self.frames.stream(self._requests(done + 1))
        try:
            self.avatar.train()
            for step, frame in enumerate(stream, done + 1):
                rendering, terms = self._step(step, frame, guard)
                done = step
                self.seconds = before + time.monotonic() - started
                self._report(step, frame, rendering, terms, train_log)
                if _is_due(step, self.plan.eval_every, self.plan.steps):
                    self._evaluate(step, eval_log)
                if _is_due(step, self.plan.save_every, self.plan.steps) or stop.received is not None:
                    self.save(step)
                    saved = step
                if stop.received is not None:
                    break
            if saved != done:
                self.save(done)
        finally:
            stream.close()
            for journal in (train_log, eval_log):
                journal.close()
            self.listener.close()
        return done

    def save(self, step: int) -> Path:
        """Write a checkpoint of the state after `step`."""
        tensors, optimizers = pack(self.avatar, self.avatar.optimizers())
        meta = {"seconds": round(self.seconds, 3), "optimizers": optimizers}
        return save_checkpoint(self.folder / "checkpoints", step, tensors, meta)

    def _requests(self, first: int) -> Iterator[tuple[int, int, int]]:
        """Frame number and size of every step from `first` on."""
        camera = self.frames.camera(self.split.train[0])
        order = random_order(self.split.train, self.seed, first)
        for step, number in zip(range(first, self.plan.steps + 1), order, strict=False):
            yield number, *self.plan.size_at(step, camera.width, camera.height)

    def _step(self, step: int, frame: Frame, guard: FiniteGuard) -> tuple[Rendering, Mapping[str, Tensor]]:
        """One update: render, compute the losses, step the optimizers, then let the method change its rows."""
        avatar = self.avatar
        rendering = self.rasterize(avatar.gaussians(frame.drive), frame.camera, self.background)
        terms = avatar.losses(frame, rendering, step)
        torch.stack(list(terms.values())).sum().backward()
        optimizers = avatar.optimizers()
        if guard.passes(step, terms, avatar):
            for optimizer in optimizers:
                step_with_rate_factor(optimizer, self.plan.rate_factor(step))
            avatar.after_backward(rendering, step)
        for optimizer in avatar.optimizers():
            optimizer.zero_grad(set_to_none=True)
        return rendering, terms

    def _report(self, step: int, frame: Frame, rendering: Rendering, terms: Mapping[str, Tensor], log: Journal) -> None:
        """Log the loss terms by name and notify the listener."""
        values = {name: value.item() for name, value in terms.items()}
        loss = sum(values.values())
        count = len(rendering.radii)
        if step % self.plan.log_every == 0 or step == self.plan.steps:
            finite = {name: value if math.isfinite(value) else None for name, value in values.items()}
            size = f"{frame.camera.width}x{frame.camera.height}"
            log.write(
                {
                    "step": step,
                    "frame": frame.drive.frame,
                    "size": size,
                    "terms": finite,
                    "gaussians": count,
                    "seconds": self.seconds,
                }
            )
        self.listener.step(step, loss, count)

    @torch.no_grad()
    def _evaluate(self, step: int, log: Journal) -> None:
        """Mean PSNR of a few test frames at full size."""
        self.avatar.eval()
        values = {}
        for number in evenly_spaced(self.split.test, self.plan.eval_frames):
            frame = self.frames.frame(number)
            rendering = self.rasterize(self.avatar.gaussians(frame.drive), frame.camera, self.background)
            error = (rendering.image.clamp(0, 1) - frame.image).square().mean()
            values[str(number)] = float(-10 * torch.log10(error.clamp_min(1e-10)))
        self.avatar.train()
        psnr = sum(values.values()) / len(values)
        log.write({"step": step, "psnr": psnr, "frames": values, "seconds": self.seconds})
        self.listener.evaluated(step, psnr)


def step_with_rate_factor(optimizer: torch.optim.Optimizer, factor: float) -> None:
    """One step at `factor` times the optimizer's learning rates, which are unchanged afterwards."""
    rates = [group["lr"] for group in optimizer.param_groups]
    for group, rate in zip(optimizer.param_groups, rates, strict=True):
        group["lr"] = factor * rate
    optimizer.step()
    for group, rate in zip(optimizer.param_groups, rates, strict=True):
        group["lr"] = rate


def _is_due(step: int, interval: int, last: int) -> bool:
    return step == last or (interval > 0 and step % interval == 0)
