"""Snapshots: the avatar of a training as it is, in one small file that is replaced every few seconds, for a viewer.

A snapshot holds what draws the avatar and nothing that trains it, is not synchronized to the disk, and is removed when
the training ends: resuming needs a checkpoint (`ggavatar.training.checkpoint`).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import torch
from safetensors import SafetensorError
from safetensors import torch as safetensors
from torch import Tensor, nn

from ggavatar.errors import InputError
from ggavatar.io.atomic import write_atomically
from ggavatar.io.regular_files import read_file
from ggavatar.text.terminal import write_err
from ggavatar.training.checkpoint import pack
from ggavatar.training.progress import Listener

SNAPSHOT = "snapshot.safetensors"
INTERVAL = 20.0
"""Least time between two snapshots, s."""
SHARE = 0.01
"""Largest share of the training's time that snapshots may take."""
MAX_BYTES = 1 << 32
_STEP = "step"


def write_snapshot(folder: Path, avatar: nn.Module, step: int) -> None:
    """Replace the snapshot in a run folder; raises `OSError` if the disk is full or the folder is gone."""
    tensors = {name: value.detach().cpu().contiguous() for name, value in pack(avatar, [])[0].items()}
    data = safetensors.save({**tensors, _STEP: torch.tensor(step)})
    write_atomically(folder / SNAPSHOT, lambda stream: stream.write(data), durable=False)


def read_snapshot(folder: Path) -> tuple[dict[str, Tensor], int] | None:
    """Tensors by name, as in a checkpoint, and the step of the snapshot in a run folder; None if there is none.

    Raises:
        InputError: It is damaged.
    """
    path = folder / SNAPSHOT
    if not path.exists():
        return None
    try:
        tensors = safetensors.load(read_file(path, MAX_BYTES, "a snapshot"))
        return tensors, int(tensors.pop(_STEP))
    except (SafetensorError, KeyError, RuntimeError, ValueError) as error:
        raise InputError(f"{path}: expected a snapshot of a training, found a damaged file ({error})") from error


class SnapshotListener:
    """Writes a snapshot every `INTERVAL` seconds, or less often where that would take more than `SHARE` of the time.

    It passes all events on. A snapshot that cannot be written is said once, and does not disturb the training.
    """

    def __init__(
        self, inner: Listener, avatar: nn.Module, folder: Path, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._inner, self._avatar, self._folder, self._clock = inner, avatar, folder, clock
        self._due = clock()
        self._is_broken = False

    def step(self, step: int, loss: Callable[[], float], gaussians: int) -> None:
        """Pass the step on, and write a snapshot if one is due."""
        self._inner.step(step, loss, gaussians)
        now = self._clock()
        if now < self._due:
            return
        try:
            write_snapshot(self._folder, self._avatar, step)
        except OSError as error:
            if not self._is_broken:
                write_err(f"warning: {self._folder / SNAPSHOT}: {error.strerror}; the viewer shows checkpoints only")
            self._is_broken = True
        done = self._clock()
        self._due = done + max(INTERVAL, (done - now) / SHARE)

    def evaluated(self, step: int, psnr: float) -> None:
        """Pass the evaluation on."""
        self._inner.evaluated(step, psnr)

    def close(self) -> None:
        """Pass the end on, and remove the snapshot: the last checkpoint is newer."""
        (self._folder / SNAPSHOT).unlink(missing_ok=True)
        self._inner.close()
