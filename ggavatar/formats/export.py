"""From a run to files of other programs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch

from ggavatar.errors import InputError
from ggavatar.formats.flame_parameters import FILE, FlameParameters, write_flame_parameters
from ggavatar.formats.gaussian_ply import full_degree, write_gaussian_ply
from ggavatar.formats.output_folder import appearing_folder, require_free
from ggavatar.formats.poses import Pose
from ggavatar.formats.splat import write_splat
from ggavatar.formats.spz import write_spz
from ggavatar.formats.stored_gaussians import Stored, stored
from ggavatar.formats.unbinding import binding_of, nearest_faces, unbind
from ggavatar.geometry.triangles import triangle_frames
from ggavatar.head.flame import JOINT_NAMES
from ggavatar.head.model import HeadModel
from ggavatar.training.run_folder import Run

WRITERS: Mapping[str, Callable[[Path, Stored], None]] = {
    "ply": write_gaussian_ply,
    "splat": write_splat,
    "spz": write_spz,
}
BOUND = "gaussian-avatars"
POINT_CLOUD = "point_cloud.ply"


class Written(NamedTuple):
    """What an export wrote.

    Attributes:
        path: A file, or a folder of files.
        gaussians: How many Gaussians a file holds.
        notes: What the format could not hold, or what the reader must know.
    """

    path: Path
    gaussians: int
    notes: tuple[str, ...]


@torch.no_grad()
def export_splats(run: Run, poses: Sequence[Pose], kind: str, path: Path, overwrite: bool) -> Written:
    """Bake poses into splat files: one pose into the file `path`, several into a folder of that name.

    Args:
        run: The avatar.
        poses: At least one.
        kind: One of `WRITERS`.
        path: Where to write.
        overwrite: Replace what an earlier export wrote.

    Raises:
        InputError: The output exists and must not be replaced.
    """
    write = WRITERS[kind]
    counts, notes = [], set()
    if len(poses) == 1:
        require_free(path, overwrite)
        rows = stored(run.avatar.gaussians(poses[0].drive))
        write(path, rows)
        return Written(path, len(rows), tuple(_lost(kind, rows)))
    with appearing_folder(path, overwrite) as folder:
        for pose in poses:
            rows = stored(run.avatar.gaussians(pose.drive))
            write(folder / f"{pose.name}.{kind}", rows)
            counts.append(len(rows))
            notes |= set(_lost(kind, rows))
    return Written(path, max(counts), tuple(sorted(notes)))


def _lost(kind: str, rows: Stored) -> list[str]:
    """What a splat format cannot hold."""
    if kind == "splat" and np.any(rows.rest):
        return ["colour that depends on the view is left out; .ply and .spz keep it"]
    return []


@torch.no_grad()
def export_bound(run: Run, head: HeadModel, pose: Pose, folder: Path, overwrite: bool) -> Written:
    """Write GaussianAvatars' layout: `point_cloud.ply` in the triangles' spaces, `flame_param.npz` of all frames.

    What a method adds to the mesh's motion (offsets of an adjuster, a torso held still) is that of `pose` in every
    frame: the layout knows nothing but triangles.

    Args:
        run: The avatar.
        head: Of its capture.
        pose: In which the Gaussians are bound.
        folder: Where to write.
        overwrite: Replace what an earlier export wrote.

    Raises:
        InputError: The head has not FLAME's joints, or the output must not be replaced.
    """
    if head.joint_names[:5] != JOINT_NAMES:
        raise InputError(
            f"{run.folder}: expected a head with FLAME's joints {', '.join(JOINT_NAMES)}, found "
            f"{', '.join(head.joint_names)}; use --format ply"
        )
    gaussians = run.avatar.gaussians(pose.drive)
    frames = triangle_frames(head.vertices(pose.drive), head.faces)
    faces = binding_of(run.avatar, len(gaussians.means), len(head.faces))
    notes = _left_out(run, head)
    if faces is None:
        faces = nearest_faces(gaussians.means, frames)
        notes.append(f"{run.method} binds no Gaussian to a triangle; each was bound to the nearest")
    rows = unbind(gaussians, faces, frames)
    with appearing_folder(folder, overwrite) as unfinished:
        write_gaussian_ply(unfinished / POINT_CLOUD, full_degree(rows))
        write_flame_parameters(unfinished / FILE, _parameters(run), len(head.template))
    return Written(folder, len(rows), tuple(notes))


def _parameters(run: Run) -> FlameParameters:
    """FLAME's parameters of all frames of the capture."""
    tracking = run.capture.tracking
    shape = np.zeros(0) if tracking.shape is None else tracking.shape
    return FlameParameters(
        shape=shape.astype(np.float32),
        expression=tracking.expression.astype(np.float32),
        joint_rotations=tracking.joint_rotations[:, :5].astype(np.float32),
        translation=tracking.translation.astype(np.float32),
    )


def _left_out(run: Run, head: HeadModel) -> list[str]:
    """What the layout cannot hold of this run."""
    tracking = run.capture.tracking
    found = []
    if not head.version.startswith("flame"):
        found.append(
            f"the head is {head.version}, not FLAME: GaussianAvatars cannot pose it, ggavatar-render --capture can"
        )
    if np.any(tracking.eyelids):
        found.append("eyelids cannot be stored")
    if np.any(tracking.joint_rotations[:, 5:]):
        found.append("joints beyond FLAME's five cannot be stored")
    if tracking.shape is None:
        found.append("the capture does not tell the identity's coefficients; shape is zero")
    return found
