"""Checkpoints: one safetensors file and one JSON file per step, written atomically and verified by digest.

The tensors are written first, the JSON last. It holds the digest of the tensors among its values, and a digest over all
values: a checkpoint is complete if and only if its JSON exists and both digests match. After a crash at any moment the
newest complete checkpoint is found and incomplete ones are skipped. Nothing in a checkpoint is executable.
"""

from __future__ import annotations

import hashlib
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
from ggavatar.io.digests import sha256_of
from ggavatar.io.held_folders import require_folder
from ggavatar.io.json_files import digest_of, read_json, write_json
from ggavatar.io.regular_files import read_file
from ggavatar.text.terminal import write_err

KEPT_CHECKPOINTS = 2
"""Number of complete checkpoints that are kept, the newest ones."""

_NAME = re.compile(r"step-(\d{9})\.json")


def save_checkpoint(folder: Path, step: int, tensors: Mapping[str, Tensor], meta: Mapping[str, Any]) -> Path:
    """Write a checkpoint, then remove all but the newest `KEPT_CHECKPOINTS` complete ones.

    Args:
        folder: The run's `checkpoints` folder.
        step: Steps done.
        tensors: By name; copied to the CPU.
        meta: JSON-serializable values.

    Returns:
        The safetensors file.

    Raises:
        OSError: The folder is gone, or the disk is full or not writable; earlier checkpoints are untouched and no
            partial file is left.
    """
    require_folder(folder)
    data = safetensors.save({name: value.detach().cpu().contiguous() for name, value in tensors.items()})
    path = folder / f"step-{step:09d}.safetensors"
    write_atomically(path, lambda stream: stream.write(data))
    record = {**meta, "step": step, "bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}
    write_json(path.with_suffix(".json"), {"record": record, "record_sha256": digest_of(record)})
    for old in complete_steps(folder, limit=None)[KEPT_CHECKPOINTS:]:
        _path(folder, old).with_suffix(".json").unlink(missing_ok=True)
        _path(folder, old).unlink(missing_ok=True)
    return path


def complete_steps(folder: Path, limit: int | None = 1) -> list[int]:
    """Steps of the complete checkpoints in a folder, newest first.

    Args:
        folder: The run's `checkpoints` folder.
        limit: How many to find, each verified by its digest; None finds all and compares only file sizes.
    """
    found = sorted(_steps(folder), reverse=True)
    if limit is None:
        return [step for step in found if _record(folder, step, digest=False)]
    complete: list[int] = []
    for step in found:
        if len(complete) == limit:
            break
        if _record(folder, step, digest=True):
            complete.append(step)
    return complete


def has_checkpoint(folder: Path) -> bool:
    """Whether a folder holds a checkpoint, complete or damaged; one whose JSON was not written yet is none."""
    return bool(_steps(folder))


def load_checkpoint(folder: Path, step: int | None = None) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Read a checkpoint.

    Args:
        folder: The run's `checkpoints` folder.
        step: Which one; None is the newest complete one.

    Returns:
        Tensors by name, on the CPU, and the JSON values.

    Raises:
        InputError: There is no such checkpoint, or it is damaged.
    """
    if step is None:
        newest = complete_steps(folder)
        if not newest:
            damaged = ", only damaged ones" if any(folder.glob("step-*")) else ""
            raise InputError(f"{folder}: no complete checkpoint{damaged}; train again with ggavatar-train --overwrite")
        step = newest[0]
        for later in sorted(other for other in _steps(folder) if other > step):
            write_err(f"warning: {_path(folder, later)}: damaged; the checkpoint of step {step} is used")
    record = _record(folder, step, digest=True)
    if record is None:
        available = ", ".join(map(str, complete_steps(folder, limit=None))) or "none"
        raise InputError(f"{_path(folder, step)}: missing or damaged; complete checkpoints: {available}")
    try:
        return safetensors.load(read_file(_path(folder, step), record["bytes"], "a checkpoint")), record
    except SafetensorError as error:
        raise InputError(f"{_path(folder, step)}: not a safetensors file ({error})") from error


def _steps(folder: Path) -> list[int]:
    """Steps of all checkpoints whose JSON exists."""
    return [int(match[1]) for path in folder.glob("step-*.json") if (match := _NAME.fullmatch(path.name))]


def _path(folder: Path, step: int) -> Path:
    return folder / f"step-{step:09d}.safetensors"


def _record(folder: Path, step: int, digest: bool) -> dict[str, Any] | None:
    """The JSON of a checkpoint if it is undamaged and its tensors match it, else None."""
    path = _path(folder, step)
    try:
        stored = read_json(path.with_suffix(".json"))
        record: dict[str, Any] = stored.get("record", stored)  # version 0.1 had the record alone
        if "record" in stored and digest_of(record) != stored["record_sha256"]:
            return None
        if record["step"] != step or path.stat().st_size != record["bytes"]:
            return None
        if digest and sha256_of(path) != record["sha256"]:
            return None
    except (OSError, InputError, KeyError, TypeError, AttributeError):
        return None
    return record


def pack(avatar: nn.Module, optimizers: list[torch.optim.Optimizer]) -> tuple[dict[str, Tensor], list[dict[str, Any]]]:
    """The state of a training: tensors by name, and the JSON-serializable remainder of every optimizer's state."""
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
    """Load an avatar's part of a checkpoint.

    Raises:
        InputError: The checkpoint belongs to another method or configuration.
    """
    own = {name.removeprefix("avatar."): value for name, value in tensors.items() if name.startswith("avatar.")}
    try:
        avatar.load_state_dict(own)
    except RuntimeError as error:
        raise InputError(f"the checkpoint does not match the method: {error}") from error


def unpack_optimizers(
    optimizers: list[torch.optim.Optimizer], tensors: Mapping[str, Tensor], rest: list[dict[str, Any]]
) -> None:
    """Load the optimizers' part of a checkpoint, after the avatar's.

    Raises:
        InputError: The checkpoint holds another number of optimizers than the method has.
    """
    if len(rest) != len(optimizers):
        raise InputError(
            f"expected a checkpoint with {len(optimizers)} optimizers, found {len(rest)}; another version of the "
            "method wrote it"
        )
    for number, (optimizer, saved) in enumerate(zip(optimizers, rest, strict=True)):
        state: dict[int, dict[str, Any]] = {int(index): dict(values) for index, values in saved["plain"].items()}
        for name, value in tensors.items():
            kind, _, remainder = name.partition(".")
            if kind == "optimizer" and remainder.startswith(f"{number}."):
                _, index, key = remainder.split(".", 2)
                state.setdefault(int(index), {})[key] = value
        optimizer.load_state_dict({"state": state, "param_groups": saved["groups"]})
