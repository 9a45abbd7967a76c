"""Follows a training: the newest avatar that its run folder holds, as a checkpoint or as a snapshot.

What cannot be read, since it is being written or is damaged, is passed over: the avatar that is shown stays.
"""

from __future__ import annotations

import copy
import threading
from collections.abc import Callable, Hashable, Mapping
from pathlib import Path

import torch
from torch import Tensor

from ggavatar.data.capture import Capture
from ggavatar.errors import InputError
from ggavatar.training.checkpoint import complete_steps, has_checkpoint, load_checkpoint, unpack_avatar
from ggavatar.training.run_folder import Run, find_capture, holds_run, open_run, read_config, run_with_tensors
from ggavatar.training.snapshot import SNAPSHOT, read_snapshot

INTERVAL = 2.0
"""Time between two looks at a run folder, s."""

Found = tuple[int, Mapping[str, Tensor]]


class Newest:
    """The newest avatar in a run folder, told once."""

    def __init__(self, folder: Path, step: int) -> None:
        """Look for what is newer than a step."""
        self._folder, self._step = folder, step
        self._seen: Hashable = None

    def look(self) -> Found | None:
        """Step and tensors of an avatar that is newer than the last one; None if there is none, or it is damaged."""
        seen = self._signature()
        if seen == self._seen:
            return None
        self._seen = seen
        found = max(
            (one for one in (self._snapshot(), self._checkpoint()) if one), key=lambda one: one[0], default=None
        )
        if found is not None:
            self._step = found[0]
        return found

    def _signature(self) -> Hashable:
        """What changes when something is written; cheap."""
        paths = [self._folder / SNAPSHOT, *sorted((self._folder / "checkpoints").glob("step-*.json"))]
        stats = []
        for path in paths:
            try:
                status = path.stat()
            except OSError:
                continue
            stats.append((path.name, status.st_mtime_ns, status.st_size, status.st_ino))
        return tuple(stats)

    def _snapshot(self) -> Found | None:
        try:
            read = read_snapshot(self._folder)
        except (InputError, OSError):
            return None
        return None if read is None or read[1] <= self._step else (read[1], read[0])

    def _checkpoint(self) -> Found | None:
        folder = self._folder / "checkpoints"
        try:
            newest = complete_steps(folder)
            if not newest or newest[0] <= self._step:
                return None
            tensors, record = load_checkpoint(folder, newest[0])
        except (InputError, OSError):  # removed meanwhile by the next one
            return None
        return record["step"], tensors


def successor(blank: torch.nn.Module, tensors: Mapping[str, Tensor], device: torch.device) -> torch.nn.Module:
    """An avatar like another one, with other tensors, in evaluation mode; the other one is unchanged.

    Raises:
        InputError: The tensors are those of another method or configuration.
    """
    avatar = copy.deepcopy(blank)
    unpack_avatar(avatar, {name: value.to(device) for name, value in tensors.items()})
    return avatar.eval()


def is_in_progress(folder: Path) -> bool:
    """Whether a run has begun and has something to show."""
    return holds_run(folder) and (has_checkpoint(folder / "checkpoints") or (folder / SNAPSHOT).exists())


def open_in_progress(folder: Path, device: str, backend: str, capture: Path | None = None) -> Run:
    """Open a run, by its snapshot if it has no checkpoint yet.

    Raises:
        InputError: As `open_run` does.
    """
    read = None if has_checkpoint(folder / "checkpoints") else read_snapshot(folder)
    if read is None:
        return open_run(folder, device, None, backend, capture)
    tensors, step = read
    opened = Capture.open(capture or find_capture(folder, read_config(folder)))
    return run_with_tensors(folder, opened, tensors, (step, "snapshot"), device, backend)


class Follower:
    """A thread that looks at a run folder now and then, and hands over what is new."""

    def __init__(self, newest: Newest, take: Callable[[Found], None], interval: float = INTERVAL) -> None:
        self._newest, self._take, self._interval = newest, take, interval
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="following", daemon=True)

    def start(self) -> None:
        """Begin to look."""
        self._thread.start()

    def stop(self) -> None:
        """Look no more."""
        self._ended.set()

    def _run(self) -> None:
        while not self._ended.wait(self._interval):
            found = self._newest.look()
            if found is not None:
                self._take(found)
