"""An avatar file as a `Run`: rendered, exported and viewed like the run that it was exported from, bit by bit.

Whoever wrote the file may not be a friend: sizes are bounded before anything is unpacked, names and numbers are
checked, and nothing in it is code. Kernels trust their indices, so these are checked here.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ggavatar.errors import InputError
from ggavatar.formats.avatar_file.container import read_container
from ggavatar.formats.avatar_file.tracking import stored_capture
from ggavatar.formats.avatar_suffix import results_beside
from ggavatar.head.files import head_from_arrays
from ggavatar.head.model import HeadModel
from ggavatar.io.dataclass_json import from_plain
from ggavatar.io.digests import sha256_of
from ggavatar.training.run_folder import Run, RunConfig, StoredAvatar, assembled_run

MAX_SETTING = 10_000_000
"""Largest whole number among the settings of a method and a training. What they make is bounded by
`ggavatar.training.build_budget`; this bounds what is not a tensor."""
_MISFITS = (
    *(RuntimeError, ValueError, TypeError, IndexError, KeyError, MemoryError, ArithmeticError, AssertionError),
    AttributeError,
)
"""What building or posing an avatar raises whose parts do not fit together."""
_REMEDY = "copy the file again, or export the avatar again with ggavatar-export RUN --format avatar"


def open_avatar_file(path: Path, device: str = "cpu", backend: str = "auto") -> Run:
    """Open an avatar file as a run, whose capture has no images (`CaptureWithoutImages`).

    Raises:
        InputError: Another kind of file, damaged, of another version, or parts that do not fit together.
    """
    described, groups = read_container(path)
    try:
        run = _run(path, described, groups, device, backend)
        _check_faces(path, run)
        with torch.no_grad():
            _check_finite(run)
    except InputError as error:
        if str(path) in str(error):
            raise
        raise InputError(f"{path}: {error}") from error
    except _MISFITS as error:
        words = str(error).split("\n")[0][:160] or type(error).__name__
        raise InputError(f"{path}: expected parts that fit together, found others ({words}); {_REMEDY}") from error
    return run


def _run(
    path: Path, described: dict[str, Any], groups: Mapping[str, Mapping[str, Tensor]], device: str, backend: str
) -> Run:
    """The parts of a file put together; what does not fit raises an `InputError` or one of `_MISFITS`."""
    head = _head(path, described.get("head"), groups["head"])
    config = _config(path, described)
    sizes = head.expression_basis.shape[2], len(head.parents)
    capture, split = stored_capture(path, described.get("clip"), groups["tracking"], head.version, sizes)
    tensors = {f"avatar.{name}": value for name, value in groups["avatar"].items()}
    stored = StoredAvatar(config, capture, head, split, tensors, _step(path, described))
    made_by = described.get("created_by")
    provenance = {"avatar_file": path.name, "created_by": made_by if isinstance(made_by, dict) else {}}
    return assembled_run(results_beside(path), stored, device, backend, provenance, sha256_of(path))


def _head(path: Path, names: Any, tensors: Mapping[str, Tensor]) -> HeadModel:
    if not isinstance(names, dict) or not isinstance(names.get("version"), str):
        raise InputError(f"{path}: expected 'head' with its names; {_REMEDY}")
    arrays: dict[str, np.ndarray] = {name: value.numpy() for name, value in tensors.items()}
    arrays["version"] = np.asarray(names["version"])
    for key in ("joint_names", "expression_names"):
        value = names.get(key)
        if not isinstance(value, list) or not all(isinstance(name, str) for name in value):
            raise InputError(f"{path}: expected {key!r} to list names; {_REMEDY}")
        if value:
            arrays[key] = np.asarray(value)
    return head_from_arrays(arrays, path)


def _config(path: Path, described: Mapping[str, Any]) -> RunConfig:
    values = described.get("config")
    if not isinstance(values, dict) or not {"method", "capture"} <= set(values):
        raise InputError(f"{path}: expected 'config' with the settings of the training; {_REMEDY}")
    large = [name for name, value in _whole_numbers(values) if abs(value) > MAX_SETTING and name != "seed"]
    if large:
        raise InputError(f"{path}: expected settings of at most {MAX_SETTING}, found a larger {large[0]!r:.40}")
    return from_plain(RunConfig, {**values, "capture": str(path)}, str(path))


def _whole_numbers(values: Mapping[str, Any]) -> Iterator[tuple[str, int]]:
    for name, value in values.items():
        if isinstance(value, Mapping):
            yield from _whole_numbers(value)
        elif isinstance(value, int):
            yield name, value


def _step(path: Path, described: Mapping[str, Any]) -> int:
    step = described.get("step")
    if type(step) is not int or not 0 <= step <= MAX_SETTING:
        raise InputError(f"{path}: expected 'step' to be a number of steps, found {step!r:.40}")
    return step


def _check_faces(path: Path, run: Run) -> None:
    """Check which triangles the rows are bound to: those of the head, or of what the avatar calls its `triangles`."""
    triangles = int(getattr(run.avatar, "triangles", len(run.head.faces)))
    for name, value in run.avatar.state_dict().items():
        if name.rpartition(".")[2] == "face" and value.numel():
            least, most = int(value.min()), int(value.max())
            if least < 0 or most >= triangles:
                raise InputError(
                    f"{path}: expected {name[:60]!r} from 0 to {triangles - 1}, found {least} to {most}; {_REMEDY}"
                )


def _check_finite(run: Run) -> None:
    """Pose the avatar once, in the drive of a frame of its clip."""
    drive = run.reader.drive(run.capture.frames[0])
    posed = run.avatar.gaussians(drive)
    for name in ("means", "quats", "scales", "opacities", "colors"):
        if not bool(torch.isfinite(getattr(posed, name)).all()):
            raise ValueError(f"{name} that are not finite")
