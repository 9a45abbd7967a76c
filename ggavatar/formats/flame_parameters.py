"""`flame_param.npz` of GaussianAvatars and VHAP: the parameters of FLAME in every timestep."""

from __future__ import annotations

import io
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray

from ggavatar.core import Drive
from ggavatar.data.frames import head_pose
from ggavatar.errors import InputError
from ggavatar.formats.flame_teeth import FLAME_VERTICES, WITH_TEETH_VERTICES
from ggavatar.head.model import HeadModel
from ggavatar.io.atomic import write_atomically
from ggavatar.io.npz import read_npz

PARAMETERS_FILE = "flame_param.npz"
MAX_ABSOLUTE_VALUE = 1e4
"""Larger numbers mean that a file is damaged."""

IDENTITY_COEFFICIENTS, EXPRESSION_COEFFICIENTS = 300, 100
"""Coefficients that GaussianAvatars reads."""

_WIDTHS = {"rotation": 3, "neck_pose": 3, "jaw_pose": 3, "eyes_pose": 6, "translation": 3}


@dataclass(frozen=True)
class FlameParameters:
    """FLAME parameters in T timesteps.

    Attributes:
        shape: Identity coefficients.
        expression: Expression coefficients.
        joint_rotations: Axis-angle of root, neck, jaw, left eye, right eye, rad.
        translation: Of the whole head, m.
        offset: Added to the template before the joints are regressed, m; None if the file has none.
    """

    shape: Float[ndarray, " S"]
    expression: Float[ndarray, "T E"]
    joint_rotations: Float[ndarray, "T 5 3"]
    translation: Float[ndarray, "T 3"]
    offset: Float[ndarray, "V 3"] | None = None

    def __len__(self) -> int:
        return len(self.expression)

    def drives(self, head: HeadModel) -> list[Drive]:
        """The timesteps as drives of a head with FLAME's five joints; further joints are at rest.

        `head_to_camera` is the head's pose in world space, as for a camera at the origin.

        Raises:
            InputError: Coefficients that the head does not have are not zero.
        """
        like = head.template
        wanted = head.expression_basis.shape[2]
        if np.any(self.expression[:, wanted:]):
            raise InputError(
                f"expected at most {wanted} expression coefficients that are not zero, found {self.expression.shape[1]}"
                "; use the head model that the parameters were made for"
            )
        used = min(wanted, self.expression.shape[1])
        expression = np.pad(self.expression[:, :used], ((0, 0), (0, wanted - used)))
        joints = np.pad(self.joint_rotations, ((0, 0), (0, len(head.parents) - 5), (0, 0)))
        columns = [torch.from_numpy(values).to(like) for values in (expression, joints, self.translation)]
        return [
            Drive(psi, theta, like.new_zeros(2), move, head_pose(head, theta, move))
            for psi, theta, move in zip(*columns, strict=True)
        ]


def read_flame_parameters(path: Path) -> FlameParameters:
    """Read the parameters of a trained GaussianAvatars, or of one timestep of VHAP.

    Raises:
        InputError: The file is of another kind, or its arrays have inconsistent shapes or are not finite.
    """
    arrays = read_npz(path, ("shape", "expr", "static_offset", *_WIDTHS))
    missing = [name for name in ("shape", "expr", *_WIDTHS) if name not in arrays]
    if missing:
        raise InputError(
            f"{path}: expected a {PARAMETERS_FILE} of GaussianAvatars, found no {', '.join(missing)}; use the one "
            "beside point_cloud.ply"
        )
    for name, values in arrays.items():
        if values.dtype.kind != "f" or not (np.abs(values) < MAX_ABSOLUTE_VALUE).all():
            raise InputError(
                f"{path}: expected finite numbers below {MAX_ABSOLUTE_VALUE:g} in {name!r}, found others; copy the "
                "file again"
            )
    expression = arrays["expr"]
    count = len(expression) if expression.ndim == 2 else 0
    for name, width in _WIDTHS.items():
        if count == 0 or arrays[name].shape != (count, width):
            raise InputError(
                f"{path}: expected {name!r} of shape ({count}, {width}) beside 'expr' of shape {expression.shape}, "
                f"found {arrays[name].shape}; copy the file again"
            )
    rotations = np.concatenate([arrays[name] for name in ("rotation", "neck_pose", "jaw_pose", "eyes_pose")], axis=1)
    return FlameParameters(
        shape=arrays["shape"].reshape(-1).astype(np.float32),
        expression=expression.astype(np.float32),
        joint_rotations=rotations.reshape(count, 5, 3).astype(np.float32),
        translation=arrays["translation"].astype(np.float32),
        offset=_offset(path, arrays.get("static_offset")),
    )


def _offset(path: Path, offset: ndarray | None) -> ndarray | None:
    if offset is None:
        return None
    if offset.ndim != 3 or offset.shape[::2] != (1, 3):
        raise InputError(f"{path}: expected 'static_offset' of shape (1, V, 3), found {offset.shape}; copy it again")
    return offset[0].astype(np.float32)


def write_flame_parameters(path: Path, parameters: FlameParameters, vertices: int) -> None:
    """Write the parameters as GaussianAvatars reads them: 300 + 100 coefficients, absent offsets as zeros.

    Args:
        path: The file.
        parameters: The parameters.
        vertices: Number of vertices of the head; for FLAME without teeth, offsets with teeth are written.
    """
    count = len(parameters)
    vertices = WITH_TEETH_VERTICES if vertices == FLAME_VERTICES else vertices
    static = np.zeros((1, vertices, 3), np.float32)
    if parameters.offset is not None:
        static[0, : len(parameters.offset)] = parameters.offset
    rotations = parameters.joint_rotations.reshape(count, 15)
    missing = max(0, EXPRESSION_COEFFICIENTS - parameters.expression.shape[1])
    arrays = {
        "shape": np.pad(parameters.shape, (0, max(0, IDENTITY_COEFFICIENTS - len(parameters.shape)))),
        "expr": np.pad(parameters.expression, ((0, 0), (0, missing))),
        "rotation": rotations[:, :3],
        "neck_pose": rotations[:, 3:6],
        "jaw_pose": rotations[:, 6:9],
        "eyes_pose": rotations[:, 9:],
        "translation": parameters.translation,
        "static_offset": static,
        "dynamic_offset": np.zeros((count, vertices, 3), np.float32),
    }
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        for name, array in arrays.items():
            entry = zipfile.ZipInfo(f"{name}.npy")
            entry.compress_type = zipfile.ZIP_DEFLATED  # almost all of the file are offsets that are zero
            with archive.open(entry, "w") as member:
                np.lib.format.write_array(member, np.asarray(array, np.float32), allow_pickle=False)
    write_atomically(path, lambda stream: stream.write(packed.getvalue()))
