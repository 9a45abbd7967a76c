"""FLAME model files (the official pickles, or an npz with the same keys) as a `HeadModel` with an identity folded in.

FLAME's license does not allow redistribution, so users supply the file. Layout: Li et al. 2017 and smplx; chumpy is not
needed.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float

from ggavatar.errors import InputError
from ggavatar.head.array_shapes import describe_shape, shape_fits
from ggavatar.head.model import HeadModel
from ggavatar.io.npz import read_npy, read_npz
from ggavatar.io.restricted_pickle import read_pickle

JOINT_NAMES = ("root", "neck", "jaw", "left_eye", "right_eye")
IDENTITY_COEFFICIENTS = 300
_KEYS = ("v_template", "f", "weights", "posedirs", "shapedirs", "J_regressor", "kintree_table")
_LID_FILES = ("l_eyelid.npy", "r_eyelid.npy")
MAX_LID_BYTES = 1 << 22
"""Largest file of eyelid displacements; metrical-tracker's have 120 kB."""


def load_flame(
    path: Path, shape: Float[np.ndarray, " S"] | None = None, version: str | None = None, expressions: int = 100
) -> HeadModel:
    """Read a FLAME file and fold an identity into its template.

    Args:
        path: `generic_model.pkl`, `flame2023.pkl` or an npz with the same keys. If they are in the same folder,
            `l_eyelid.npy` and `r_eyelid.npy` (metrical-tracker) supply the eyelids and `FLAME_masks.pkl` the regions.
        shape: Identity coefficients, at most as many as the file has; None is the mean face.
        version: Tag of the parameter space; None derives it from the file's name.
        expressions: Number of expression coefficients to keep.

    Raises:
        InputError: The file is not a FLAME model, or the shapes of its arrays do not fit together.
    """
    arrays = _read(path)
    count = len(arrays["v_template"])
    basis = arrays["shapedirs"]
    identities = min(IDENTITY_COEFFICIENTS, max(basis.shape[2] - expressions, 0))
    template = arrays["v_template"] + _identity(path, basis[:, :, :identities], shape)
    return HeadModel(
        template=_float(template),
        faces=torch.from_numpy(arrays["f"].astype(np.int64)),
        expression_basis=_float(basis[:, :, identities : identities + expressions]),
        pose_basis=_float(arrays["posedirs"].reshape(count, 3, -1)),
        eyelid_basis=_float(_eyelids(path.parent, count)),
        joint_regressor=_float(arrays["J_regressor"]),
        skinning_weights=_float(arrays["weights"]),
        parents=tuple(int(parent) for parent in arrays["kintree_table"][0].astype(np.int64).astype(np.int32)),
        joint_names=JOINT_NAMES,
        version=version or flame_version(path),
        regions=_regions(path.parent / "FLAME_masks.pkl", count),
    )


def flame_version(path: Path) -> str:
    """The version tag of a FLAME file by its name: `flame2023`, `flame2023-open`, or else `flame2020`."""
    if "2023" not in path.name:
        return "flame2020"
    return "flame2023-open" if "open" in path.name.lower() else "flame2023"


def is_flame(path: Path) -> bool:
    """Whether a head-model file has FLAME's layout (a pickle, or an npz with `v_template`) rather than ours."""
    if path.is_dir():
        return False
    if path.suffix.lower() in (".pkl", ".pickle"):
        return True
    return path.suffix.lower() == ".npz" and "v_template" in read_npz(path, ["v_template"])


def _float(array: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(array, dtype=np.float32))


def _read(path: Path) -> dict[str, np.ndarray]:
    """The arrays of the file; `InputError` if one is missing or has a wrong shape, type or value."""
    content = read_npz(path, _KEYS) if path.suffix.lower() == ".npz" else read_pickle(path)
    if not isinstance(content, Mapping):
        raise InputError(f"{path}: expected a FLAME model, found {type(content).__name__}")
    missing = [key for key in _KEYS if not isinstance(content.get(key), np.ndarray)]
    if missing:
        raise InputError(
            f"{path}: expected a FLAME model, but it has no {', '.join(missing)}; use generic_model.pkl or "
            "flame2023.pkl"
        )
    arrays = {key: content[key] for key in _KEYS}
    _check(path, arrays)
    return arrays


def _check(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Refuse arrays of wrong shapes, numbers that are not finite, and faces or parents out of range."""
    vertices, joints = len(arrays["v_template"]), len(JOINT_NAMES)
    wanted: dict[str, tuple[int | None, ...]] = {
        "v_template": (vertices, 3),
        "f": (None, 3),
        "weights": (vertices, joints),
        "posedirs": (vertices, 3, 9 * (joints - 1)),
        "shapedirs": (vertices, 3, None),
        "J_regressor": (joints, vertices),
        "kintree_table": (2, joints),
    }
    for key, shape in wanted.items():
        array = arrays[key]
        if not shape_fits(array.shape, shape) or array.dtype.kind not in "fiu" or not np.isfinite(array).all():
            raise InputError(
                f"{path}: expected finite numbers of shape {describe_shape(shape)} for {key!r}, found {array.dtype} "
                f"{list(array.shape)}; use generic_model.pkl or flame2023.pkl as downloaded"
            )
    faces = arrays["f"]
    if faces.size == 0 or faces.min() < 0 or faces.max() >= vertices:
        found = f"{faces.min()} to {faces.max()}" if faces.size else "no faces"
        raise InputError(f"{path}: expected vertex indices from 0 to {vertices - 1} in 'f', found {found}")
    parents = arrays["kintree_table"][0].astype(np.int64).astype(np.int32)
    if parents[0] != -1 or not all(0 <= parent < child for child, parent in enumerate(parents[1:], start=1)):
        raise InputError(f"{path}: expected the parents -1 0 1 1 1 in 'kintree_table', found {parents.tolist()}")


def _identity(path: Path, basis: np.ndarray, shape: np.ndarray | None) -> np.ndarray | float:
    """Displacement of the template for identity coefficients, or 0 for the mean face."""
    if shape is None or not np.any(shape):
        return 0.0
    if len(shape) > basis.shape[2] and np.any(shape[basis.shape[2] :]):
        raise InputError(
            f"{path}: the tracking has {len(shape)} identity coefficients, the model only {basis.shape[2]}; use the "
            "full FLAME model"
        )
    used = min(len(shape), basis.shape[2])
    return basis[:, :, :used] @ np.asarray(shape[:used], dtype=np.float64)


def _eyelids(folder: Path, count: int) -> np.ndarray:
    """Eyelid displacements of metrical-tracker if their files are in the model's folder, else zeros."""
    lids = np.zeros((count, 3, 2))
    for side, name in enumerate(_LID_FILES):
        if (folder / name).is_file():
            lids[:, :, side] = _lid(folder / name, count)
    return lids


def _lid(path: Path, count: int) -> np.ndarray:
    lid = read_npy(path, MAX_LID_BYTES)
    if lid.shape != (count, 3) or lid.dtype.kind != "f" or not np.isfinite(lid).all():
        raise InputError(f"{path}: expected finite floating-point numbers of shape [{count}, 3]")
    return lid


def _regions(path: Path, count: int) -> dict[str, torch.Tensor]:
    """Vertex sets of FLAME_masks.pkl if it exists, else none."""
    if not path.is_file():
        return {}
    content: Any = read_pickle(path)
    if not isinstance(content, Mapping):
        raise InputError(f"{path}: expected a dictionary of vertex indices, found {type(content).__name__}")
    regions = {}
    for name, rows in content.items():
        if (
            not isinstance(rows, np.ndarray)
            or rows.dtype.kind not in "iu"
            or rows.ndim != 1
            or (rows.size and rows.max() >= count)
        ):
            raise InputError(f"{path}: expected vertex indices below {count} for {name!r}")
        regions[str(name)] = torch.from_numpy(rows.astype(np.int64))
    return regions
