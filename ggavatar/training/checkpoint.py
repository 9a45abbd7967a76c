"""Checkpoints: one safetensors file and one JSON file a step. Atomic, checked by digest, nothing executable.

The tensors go to the disk first, the JSON with their digest last; a checkpoint exists if and only if its JSON is
there and its digest fits. Whatever the moment of a crash, the newest complete checkpoint is found and torn ones are
skipped.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors import torch as safetensors
from torch import Tensor, nn

from ggavatar.errors import InputError
from ggavatar.io.atomic import write_atomically

KEPT = 2
"""Complete checkpoints that are never removed."""

_NAME = re.compile(r"step-(\d{9})\.json")


def save_checkpoint(folder: Path, step: int, tensors: Mapping[str, Tensor], meta: Mapping[str, Any]) -> Path:
    """Write a checkpoint, then remove all but the newest `KEPT` complete ones.

    Args:
        folder: The run's `checkpoints` folder.
        step: Steps done.
        tensors: By name; copied to the CPU.
        meta: JSON-ready values.

    Returns:
        The safetensors file.

    Raises:
        OSError: The disk is full or not writable; earlier checkpoints are untouched and no half file is left.
    """
    data = safetensors.save({name: value.detach().cpu().contiguous() for name, value in tensors.items()})
    path = folder / f"step-{step:09d}.safetensors"
    write_atomically(path, lambda stream: stream.write(data))
    record = {**meta, "step": step, "bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}
    text = json.dumps(record, indent=1, allow_nan=False).encode()
    write_atomically(path.with_suffix(".json"), lambda stream: stream.write(text))
    for old in complete_steps(folder, limit=None)[KEPT:]:
        _path(folder, old).with_suffix(".json").unlink(missing_ok=True)
        _path(folder, old).unlink(missing_ok=True)
    return path


def complete_steps(folder: Path, limit: int | None = 1) -> list[int]:
    """Steps of complete checkpoints, newest first.

    At most `limit` of them (None: all, sizes checked but not digests).
    """
    found = sorted(
        (int(match[1]) for path in folder.glob("step-*.json") if (match := _NAME.fullmatch(path.name))), reverse=True
    )
    if limit is None:
        return [step for step in found if _record(folder, step, digest=False)]
    complete: list[int] = []
    for step in found:
        if len(complete) == limit:
            break
        if _record(folder, step, digest=True):
            complete.append(step)
    return complete


def load_checkpoint(folder: Path, step: int | None = None) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Read a checkpoint.

    Args:
        folder: The run's `checkpoints` folder.
        step: Which; None is the newest complete one.

    Returns:
        Tensors by name, on the CPU, and the JSON values.

    Raises:
        InputError: No such checkpoint, or it is torn.
    """
    if step is None:
        newest = complete_steps(folder)
        if not newest:
            damaged = ", only damaged ones" if any(folder.glob("step-*")) else ""
            raise InputError(f"{folder}: no complete checkpoint{damaged}; begin again with ggavatar-train --overwrite")
        step = newest[0]
    record = _record(folder, step, digest=True)
    if record is None:
        there = ", ".join(map(str, complete_steps(folder, limit=None))) or "none"
        raise InputError(f"{_path(folder, step)}: missing or damaged; complete checkpoints: {there}")
    try:
        return safetensors.load(_path(folder, step).read_bytes()), record
    except SafetensorError as error:
        raise InputError(f"{_path(folder, step)}: not a safetensors file ({error})") from error


def _path(folder: Path, step: int) -> Path:
    return folder / f"step-{step:09d}.safetensors"


def _record(folder: Path, step: int, digest: bool) -> dict[str, Any] | None:
    """The JSON of a checkpoint whose tensors are as it says, else None."""
    path = _path(folder, step)
    try:
        record = json.loads(path.with_suffix(".json").read_text())
        if not isinstance(record, dict) or path.stat().st_size != record["bytes"]:
            return None
        if digest and hashlib.sha256(path.read_bytes()).hexdigest() != record["sha256"]:
            return None
    except (OSError, ValueError, KeyError):
        return None
    return record


def pack(avatar: nn.Module, optimizers: list[torch.optim.Optimizer]) -> tuple[dict[str, Tensor], list[dict[str, Any]]]:
    """Everything that decides how a training goes on: tensors by name and the JSON-ready rest of every optimiser."""
    tensors = {f"avatar.{name}": value for name, value in avatar.state_dict().items()}
    rest = []
    for number, optimizer in enumerate(optimizers):
        state = optimizer.state_dict()
        plain: dict[str, dict[str, Any]] = {}
        for index, values in state["state"].items():
            for key, value in values.items():
                if isinstance(value, Tensor):
                    tensors[f"optimizer.{number}.{index}.{key}"] = value
                else:
                    plain.setdefault(str(index), {})[key] = value
        rest.append({"groups": state["param_groups"], "plain": plain})
    return tensors, rest


def unpack_avatar(avatar: nn.Module, tensors: Mapping[str, Tensor]) -> None:
    """Load an avatar's part of a checkpoint; `InputError` if it belongs to another method or configuration."""
    own = {name.removeprefix("avatar."): value for name, value in tensors.items() if name.startswith("avatar.")}
    try:
        avatar.load_state_dict(own)
    except RuntimeError as error:
        raise InputError(f"the checkpoint does not fit the method: {error}") from error


def unpack_optimizers(
    optimizers: list[torch.optim.Optimizer], tensors: Mapping[str, Tensor], rest: list[dict[str, Any]]
) -> None:
    """Load the optimisers' part of a checkpoint, after the avatar's."""
    if len(rest) != len(optimizers):
        raise InputError(
            f"the checkpoint has {len(rest)} optimisers, the method {len(optimizers)}; another version wrote it"
        )
    for number, (optimizer, saved) in enumerate(zip(optimizers, rest, strict=True)):
        state: dict[int, dict[str, Any]] = {int(index): dict(values) for index, values in saved["plain"].items()}
        for name, value in tensors.items():
            kind, _, remainder = name.partition(".")
            if kind == "optimizer" and remainder.startswith(f"{number}."):
                _, index, key = remainder.split(".", 2)
                state.setdefault(int(index), {})[key] = value
        optimizer.load_state_dict({"state": state, "param_groups": saved["groups"]})
