"""The training loop, which is the same for all methods: a method takes part through `ggavatar.core.Avatar` alone."""

from __future__ import annotations

import functools
import math
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
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
from ggavatar.training.finite_guard import DeviceGuard, FiniteGuard, clear_if, step_unless
from ggavatar.training.journal import Journal
from ggavatar.training.plan import TrainingPlan
from ggavatar.training.progress import Listener


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
        device = self.background.device
        guard = DeviceGuard(self.plan.bad_steps, device) if device.type == "cuda" else FiniteGuard(self.plan.bad_steps)
        for name in ("checkpoints", "metrics"):
            make_folder(self.folder / name)
        train_log, eval_log = (Journal(self.folder / "metrics" / name, done) for name in ("train.jsonl", "eval.jsonl"))
        started, before = time.monotonic(), self.seconds
        saved = done
        stream = self.frames.stream(self._requests(done + 1))
        waiting = Stopwatch()
        try:
            self.avatar.train()
            for step, frame in enumerate(waiting.around(stream), done + 1):
                rendering, terms = self._step(step, frame, guard)
                done = step
                self.seconds = before + time.monotonic() - started
                if step % self.plan.log_every == 0 or step == self.plan.steps:
                    values = _read_terms(step, terms, guard)
                    self._log(step, frame, len(rendering.radii), values, waiting.take(), train_log)
                self.listener.step(step, _total(terms), len(rendering.radii))
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

    def _step(
        self, step: int, frame: Frame, guard: FiniteGuard | DeviceGuard
    ) -> tuple[Rendering, Mapping[str, Tensor]]:
        """One update: render, compute the losses, step the optimizers, then let the method change its rows."""
        avatar = self.avatar
        rendering = self.rasterize(avatar.gaussians(frame.drive), frame.camera, self.background)
        terms = avatar.losses(frame, rendering, step)
        loss = torch.stack(list(terms.values())).sum()
        loss.backward()
        optimizers = avatar.optimizers()
        if isinstance(guard, DeviceGuard):
            self._update_unless(guard.mark(loss, avatar), rendering, step)
        elif guard.passes(step, terms, avatar):
            for optimizer in optimizers:
                step_with_rate_factor(optimizer, self.plan.rate_factor(step))
            avatar.after_backward(rendering, step)
        for optimizer in avatar.optimizers():
            optimizer.zero_grad(set_to_none=True)
        return rendering, terms

    def _update_unless(self, is_bad: Tensor, rendering: Rendering, step: int) -> None:
        """The update on a device, which leaves it out by itself where `is_bad` is 1; statistics get nothing then."""
        for optimizer in self.avatar.optimizers():
            step_with_rate_factor(optimizer, self.plan.rate_factor(step), functools.partial(step_unless, is_bad))
        clear_if(is_bad, rendering.radii)  # nothing was visible, so that density control learns nothing
        self.avatar.after_backward(rendering, step)

    def _log(
        self, step: int, frame: Frame, count: int, values: Mapping[str, float], waited: float, log: Journal
    ) -> None:
        """Log the loss terms by name, and how long the steps since the last line waited for their frames, s."""
        log.write(
            {
                "step": step,
                "frame": frame.drive.frame,
                "size": f"{frame.camera.width}x{frame.camera.height}",
                "terms": {name: value if math.isfinite(value) else None for name, value in values.items()},
                "gaussians": count,
                "seconds": self.seconds,
                "waited": round(waited, 6),
            }
        )

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


class Stopwatch:
    """Time spent on waiting for the elements of an iterator."""

    def __init__(self) -> None:
        self._seconds = 0.0

    def around(self, elements: Iterator[Frame]) -> Iterator[Frame]:
        """The elements, each waited for on the clock."""
        while True:
            began = time.monotonic()
            element = next(elements, None)
            self._seconds += time.monotonic() - began
            if element is None:
                return
            yield element

    def take(self) -> float:
        """Seconds since the last call."""
        taken, self._seconds = self._seconds, 0.0
        return taken


def _read_terms(step: int, terms: Mapping[str, Tensor], guard: FiniteGuard | DeviceGuard) -> dict[str, float]:
    """The loss terms as numbers; with one wait for a device, on which its count of bad steps is read too.

    Raises:
        TrainingError: The device has counted too many.
    """
    if not isinstance(guard, DeviceGuard):
        return {name: value.item() for name, value in terms.items()}
    *values, with_loss, with_gradient = torch.cat((torch.stack(list(terms.values())).detach(), guard.counts)).tolist()
    guard.check(step, (with_loss, with_gradient))
    return dict(zip(terms, values, strict=True))


def _total(terms: Mapping[str, Tensor]) -> Callable[[], float]:
    """The loss, read when it is asked for: a listener that shows no number does not wait for a device."""
    return lambda: sum(value.item() for value in terms.values())


def step_with_rate_factor(
    optimizer: torch.optim.Optimizer,
    factor: float,
    take_step: Callable[[torch.optim.Optimizer], object] = lambda one: one.step(),
) -> None:
    """One step at `factor` times the optimizer's learning rates, which are unchanged afterwards."""
    rates = [group["lr"] for group in optimizer.param_groups]
    for group, rate in zip(optimizer.param_groups, rates, strict=True):
        group["lr"] = factor * rate
    take_step(optimizer)
    for group, rate in zip(optimizer.param_groups, rates, strict=True):
        group["lr"] = rate


def _is_due(step: int, interval: int, last: int) -> bool:
    return step == last or (interval > 0 and step % interval == 0)
