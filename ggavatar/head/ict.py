"""ICT-FaceKit's light face model (MIT; a folder of OBJ files) as a `HeadModel` with an identity folded in.

Layout: ICT-VGL/ICT-FaceKit README: one OBJ of the same topology for the neutral face, for 100 identity modes and for 53
expressions named after ARKit's; centimeters, +Y up, +Z forward. Transparent helper surfaces (tears, eye blends and
occlusion, eyelashes) are left out. The light model has no rig: expressions move jaw and lids, and joints are the two
eyeballs and a root; `neck` is the root again.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int

from ggavatar.errors import InputError
from ggavatar.head.model import HeadModel
from ggavatar.head.still_joints import still_joint_regressor
from ggavatar.io.regular_files import read_file

NEUTRAL = "generic_neutral_mesh.obj"
VERTICES = 26_719
KEPT_VERTICES = 24_591
"""Face, head and neck, mouth and eye sockets, gums, tongue, teeth and eyeballs come first; the helpers follow."""

IDENTITIES = 100
METERS = 0.01
_PARTS = {
    "face": (0, 9409),
    "head_and_neck": (9409, 11248),
    "mouth": (11248, 13294),
    "teeth": (17039, 21451),
    "left_eyeball": (21451, 23021),
    "right_eyeball": (23021, 24591),
}
_SIDED = """
browDown browInnerUp browOuterUp cheekPuff cheekSquint eyeBlink eyeLookDown eyeLookIn eyeLookOut eyeLookUp eyeSquint
eyeWide mouthDimple mouthFrown mouthLowerDown mouthPress mouthSmile mouthStretch mouthUpperUp noseSneer
"""
_SINGLE = """
jawForward jawLeft jawOpen jawRight mouthClose mouthFunnel mouthLeft mouthPucker mouthRight mouthRollLower
mouthRollUpper mouthShrugLower mouthShrugUpper
"""
EXPRESSIONS = tuple(sorted([*(f"{name}_{side}" for name in _SIDED.split() for side in "LR"), *_SINGLE.split()]))
"""The 53 expressions in the order of the coefficients."""

_MAX_OBJ_BYTES = 1 << 24
_VERTEX = re.compile(rb"^v\s+(\S+)\s+(\S+)\s+(\S+)", re.MULTILINE)
_FACE = re.compile(rb"^f\s+([^\r\n]+)", re.MULTILINE)


def ict_folder(path: Path) -> Path | None:
    """The folder with the OBJ files: the path itself or `FaceXModel` in it; None if there is none."""
    return next((place for place in (path, path / "FaceXModel") if (place / NEUTRAL).is_file()), None)


def load_ict(path: Path, identity: Float[np.ndarray, " S"] | None = None) -> HeadModel:
    """Read the folder and fold an identity into the template.

    Args:
        path: `FaceXModel`, or the folder of the repository with it.
        identity: Weights of at most 100 identity modes; None is the generic face.

    Raises:
        InputError: Not such a folder, or a file in it is missing, damaged or of another topology.
    """
    folder = ict_folder(path)
    if folder is None:
        raise InputError(f"{path}: expected ICT-FaceKit's folder FaceXModel with {NEUTRAL}, found none")
    neutral = _vertices(folder / NEUTRAL)
    faces = _triangles(folder / NEUTRAL)
    template = neutral + _identity(folder, neutral, identity)
    basis = np.stack([_vertices(folder / f"{name}.obj") - neutral for name in EXPRESSIONS], axis=2)
    joints = np.stack([_root(template), _root(template), *(_center(template, side) for side in ("left", "right"))])
    weights = np.zeros((KEPT_VERTICES, 4))
    weights[:, 1] = 1
    for column, side in ((2, "left"), (3, "right")):
        rows = slice(*_PARTS[f"{side}_eyeball"])
        weights[rows, 1], weights[rows, column] = 0, 1
    return HeadModel(
        template=_float(template),
        faces=torch.from_numpy(faces),
        expression_basis=_float(basis),
        pose_basis=torch.zeros(KEPT_VERTICES, 3, 0),
        eyelid_basis=torch.zeros(KEPT_VERTICES, 3, 2),
        joint_regressor=_float(still_joint_regressor(folder, template, basis, joints)),
        skinning_weights=_float(weights),
        parents=(-1, 0, 1, 1),
        joint_names=("root", "neck", "left_eye", "right_eye"),
        version="ict-facekit-1",
        regions={name: torch.arange(*rows) for name, rows in _PARTS.items()},
        expression_names=EXPRESSIONS,
    )


def _float(array: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(array, dtype=np.float32))


def _root(template: np.ndarray) -> np.ndarray:
    """A point inside of the neck: the middle of the lowest tenth of the head."""
    low, high = template[:, 1].min(), template[:, 1].max()
    return template[template[:, 1] < low + 0.1 * (high - low)].mean(axis=0)


def _center(template: np.ndarray, side: str) -> np.ndarray:
    return template[slice(*_PARTS[f"{side}_eyeball"])].mean(axis=0)


def _identity(folder: Path, neutral: np.ndarray, identity: np.ndarray | None) -> np.ndarray | float:
    if identity is None or not np.any(identity):
        return 0.0
    if np.any(identity[IDENTITIES:]):
        raise InputError(f"{folder}: expected at most {IDENTITIES} identity weights, found {len(identity)}")
    total = np.zeros_like(neutral)
    for index in np.flatnonzero(identity[:IDENTITIES]):
        total += identity[index] * (_vertices(folder / f"identity{index:03d}.obj") - neutral)
    return total


def _content(path: Path) -> bytes:
    if not path.is_file():
        raise InputError(f"{path}: no such file; download the whole folder FaceXModel of ICT-FaceKit")
    return read_file(path, _MAX_OBJ_BYTES, "an OBJ file")


def _vertices(path: Path) -> Float[np.ndarray, "V 3"]:
    """The kept vertices of an OBJ file, m."""
    found = _VERTEX.findall(_content(path))
    if len(found) != VERTICES:
        raise InputError(
            f"{path}: expected {VERTICES} vertices as in ICT-FaceKit, found {len(found)}; download it again"
        )
    try:
        values = np.array(found[:KEPT_VERTICES]).astype(np.float64) * METERS
    except ValueError as error:
        raise InputError(f"{path}: expected three numbers for every vertex ({error}); download it again") from error
    if not (np.abs(values) < 1).all():
        raise InputError(
            f"{path}: expected a head in centimeters, found lengths of a meter and more; download it again"
        )
    return values


def _triangles(path: Path) -> Int[np.ndarray, "F 3"]:
    """The polygons whose corners are all kept, split into triangles."""
    triangles = []
    for match in _FACE.finditer(_content(path)):
        corners = [corner.split(b"/")[0] for corner in match[1].split()]
        if not 3 <= len(corners) <= 16 or not all(corner.isdigit() and len(corner) < 9 for corner in corners):
            raise InputError(f"{path}: expected polygons of vertex numbers, found {match[1][:40]!r}; download it again")
        rows = [int(corner) - 1 for corner in corners]
        if min(rows) < 0 or max(rows) >= VERTICES:
            raise InputError(f"{path}: expected vertex numbers from 1 to {VERTICES}; download it again")
        if max(rows) < KEPT_VERTICES:
            triangles += [(rows[0], rows[place], rows[place + 1]) for place in range(1, len(rows) - 1)]
    if not triangles:
        raise InputError(f"{path}: expected polygons, found none; download it again")
    return np.array(triangles, dtype=np.int64)
