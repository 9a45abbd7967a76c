"""`head.npz`: a head model on disk without pickled objects (docs/capture-format.md).

The checks are written out here: schema libraries such as pydantic validate JSON, not the shapes and values of arrays.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int
from numpy import ndarray

from ggavatar.errors import InputError
from ggavatar.head.array_shapes import describe_shape, shape_fits
from ggavatar.head.expression_axes import names_without_file
from ggavatar.head.model import HeadModel
from ggavatar.io.atomic import write_atomically
from ggavatar.io.npz import npz_headers, read_npz

MAX_VERTICES = 2_000_000
_REAL = ("template", "expression_basis", "pose_basis", "eyelid_basis", "joint_regressor", "skinning_weights")
_REQUIRED = (*_REAL, "faces", "parents", "joint_names", "version")
_OPTIONAL = ("uv", "landmark_weights", "expression_names")
_REGION = "region/"


def save_head(head: HeadModel, path: Path | str) -> None:
    """Write a head as `head.npz`, atomically."""
    arrays = head_arrays(head)
    write_atomically(Path(path), lambda stream: np.savez_compressed(stream, allow_pickle=False, **arrays))


def head_arrays(head: HeadModel) -> dict[str, ndarray]:
    """The arrays of a head by their names in `head.npz`."""
    arrays: dict[str, ndarray] = {name: getattr(head, name).detach().cpu().numpy() for name in (*_REAL, "faces")}
    arrays |= {
        "parents": np.asarray(head.parents, np.int64),
        "joint_names": np.asarray(head.joint_names),
        "version": np.asarray(head.version),
    }
    arrays |= {_REGION + name: rows.cpu().numpy() for name, rows in head.regions.items()}
    optional = {"uv": head.uv, "landmark_weights": head.landmark_weights}
    arrays |= {name: value.detach().cpu().numpy() for name, value in optional.items() if value is not None}
    return arrays | ({"expression_names": np.asarray(head.expression_names)} if head.expression_names else {})


def load_head(path: Path | str) -> HeadModel:
    """Read a head model from `head.npz`, float32 on the CPU; every key is checked.

    Raises:
        InputError: The file is missing, not an npz or too large, or as `head_from_arrays`.
    """
    return head_from_arrays(_read(Path(path)), Path(path))


def head_from_arrays(arrays: dict[str, ndarray], path: Path) -> HeadModel:
    """A head model from the arrays of a `head.npz`, which may come from another file.

    Args:
        arrays: As `head_arrays` gives them.
        path: Where they come from, for messages.

    Raises:
        InputError: A key is missing or has a wrong shape or type, an index is out of range or a number not finite.
    """
    check = _Checks(path, arrays)
    vertices = check.sizes()
    faces = torch.from_numpy(check.faces(vertices))
    real = {name: torch.from_numpy(check.real(name, vertices)) for name in _REAL}
    joints = real["joint_regressor"].shape[0]
    regions = {
        key.removeprefix(_REGION): torch.from_numpy(check.rows(key, vertices))
        for key in arrays
        if key.startswith(_REGION)
    }
    uv = torch.from_numpy(check.uv()) if "uv" in arrays else None
    weights = torch.from_numpy(check.landmark_weights()) if "landmark_weights" in arrays else None
    return HeadModel(
        **real,
        faces=faces,
        parents=check.parents(joints),
        joint_names=check.names(joints),
        version=str(check.text("version", 0)),
        regions=regions,
        uv=uv,
        landmark_weights=weights,
        expression_names=check.expression_names(str(check.text("version", 0))),
    )


def _read(path: Path) -> dict[str, ndarray]:
    """The known arrays of the file; others are ignored."""
    if not path.is_file():
        raise InputError(
            f"expected a head model file (head.npz), found {'a folder' if path.is_dir() else 'nothing'} at {path}"
        )
    known = {*_REQUIRED, *_OPTIONAL}
    return read_npz(path, [key for key in npz_headers(path) if key in known or key.startswith(_REGION)])


class _Checks:
    """Checks of single keys; messages name the file and the key."""

    def __init__(self, path: Path, arrays: dict[str, ndarray]) -> None:
        self._path, self._arrays = path, arrays
        missing = [key for key in _REQUIRED if key not in arrays]
        if missing:
            raise InputError(f"{path}: expected the keys {', '.join(_REQUIRED)}; missing: {', '.join(missing)}")

    def _require(self, condition: bool, key: str, expected: str) -> None:
        if not condition:
            value = self._arrays[key]
            raise InputError(
                f"{self._path}: {key}: expected {expected}, found {value.dtype} {list(value.shape)}; "
                "write the file with save_head"
            )

    def sizes(self) -> int:
        """Number of vertices, from the template."""
        template = self._arrays["template"]
        self._require(template.ndim == 2 and template.shape[1] == 3, "template", "shape [V, 3]")
        self._require(0 < len(template) <= MAX_VERTICES, "template", f"1 to {MAX_VERTICES} vertices")
        return len(template)

    def real(self, key: str, vertices: int) -> Float[ndarray, "..."]:
        """A finite floating-point array of the expected shape, as float32."""
        value = self._arrays[key]
        joints = self._arrays["joint_regressor"].shape[0]
        shapes = {
            "template": (vertices, 3),
            "expression_basis": (vertices, 3, None),
            "pose_basis": (vertices, 3, None),
            "eyelid_basis": (vertices, 3, 2),
            "joint_regressor": (joints, vertices),
            "skinning_weights": (vertices, joints),
        }
        self._require(value.dtype.kind == "f", key, "floating point")
        self._require(shape_fits(value.shape, shapes[key]), key, f"shape {describe_shape(shapes[key])}")
        self._require(bool(np.isfinite(value).all()), key, "finite numbers only")
        if key == "pose_basis":
            self._require(value.shape[2] in (0, 9 * (joints - 1)), key, f"0 or {9 * (joints - 1)} pose correctives")
        if key == "skinning_weights":
            self._require(bool(np.abs(value.sum(axis=1) - 1).max() < 1e-3), key, "rows that sum to 1")
        return np.ascontiguousarray(value, np.float32)

    def rows(self, key: str, count: int) -> Int[ndarray, "..."]:
        """Indices of at least 0 and below `count`."""
        value = self._arrays[key]
        self._require(value.dtype.kind in "iu", key, "integers")
        self._require(
            value.size == 0 or (int(value.min()) >= 0 and int(value.max()) < count),
            key,
            f"indices from 0 to {count - 1}",
        )
        if key.startswith(_REGION):
            self._require(value.ndim == 1, key, "shape [R]")
        return np.ascontiguousarray(value, np.int64)

    def faces(self, vertices: int) -> Int[ndarray, "F 3"]:
        """Vertex indices of the triangles."""
        value = self._arrays["faces"]
        self._require(value.ndim == 2 and value.shape[1] == 3 and len(value) > 0, "faces", "shape [F, 3] with F > 0")
        return self.rows("faces", vertices)

    def parents(self, joints: int) -> tuple[int, ...]:
        """Parent joints: −1 first, and every parent before its children."""
        value = self._arrays["parents"]
        self._require(
            value.dtype.kind in "iu" and value.shape == (joints,) and joints > 0, "parents", f"{joints} integers"
        )
        parents = tuple(int(parent) for parent in value.astype(np.int64))
        ordered = parents[0] == -1 and all(0 <= parent < index for index, parent in enumerate(parents) if index)
        self._require(ordered, "parents", "−1 first and every parent before its children")
        return parents

    def names(self, joints: int) -> tuple[str, ...]:
        """Distinct joint names."""
        names = tuple(str(name) for name in self.text("joint_names", 1))
        self._require(len(set(names)) == len(names) == joints, "joint_names", f"{joints} distinct names")
        return names

    def expression_names(self, version: str) -> tuple[str, ...]:
        """What the expression coefficients mean; older files of our tracker do not say it."""
        count = self._arrays["expression_basis"].shape[2]
        if "expression_names" not in self._arrays:
            return names_without_file(version, count)
        names = tuple(str(name) for name in self.text("expression_names", 1))
        self._require(len(set(names)) == len(names) == count, "expression_names", f"{count} distinct names")
        return names

    def text(self, key: str, dimensions: int) -> ndarray:
        """A Unicode array with the given number of dimensions."""
        value = self._arrays[key]
        self._require(
            value.dtype.kind == "U" and value.ndim == dimensions, key, f"unicode with {dimensions} dimensions"
        )
        return value

    def uv(self) -> Float[ndarray, "F 3 2"]:
        """Texture coordinates, one for each corner of every face."""
        value = self._arrays["uv"]
        self._require(value.dtype.kind == "f", "uv", "floating point")
        self._require(value.shape == (len(self._arrays["faces"]), 3, 2), "uv", "shape [F, 3, 2]")
        self._require(bool(np.isfinite(value).all()), "uv", "finite numbers only")
        return np.ascontiguousarray(value, np.float32)

    def landmark_weights(self) -> Float[ndarray, "L 3"]:
        """Barycentric weights, three for each landmark; the region of their corners must be in the file too."""
        value, corners = self._arrays["landmark_weights"], self._arrays.get(_REGION + "landmarks", np.zeros(0))
        self._require(value.dtype.kind == "f", "landmark_weights", "floating point")
        self._require(
            value.shape == (len(corners) // 3, 3), "landmark_weights", "shape [L, 3] for 3·L region/landmarks"
        )
        self._require(bool(np.isfinite(value).all()), "landmark_weights", "finite numbers only")
        return np.ascontiguousarray(value, np.float32)
