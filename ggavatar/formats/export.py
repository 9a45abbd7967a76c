"""Export of a run to the file formats of other programs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch

from ggavatar.core import Drive
from ggavatar.errors import InputError
from ggavatar.formats.drives import NamedDrive
from ggavatar.formats.flame_parameters import PARAMETERS_FILE, FlameParameters, write_flame_parameters
from ggavatar.formats.output_folder import atomic_folder, check_output_file, output_file
from ggavatar.formats.splat_formats import plugged_format
from ggavatar.formats.splats.gaussian_ply import full_degree, write_gaussian_ply
from ggavatar.formats.splats.glb import write_glb
from ggavatar.formats.splats.splat import write_splat
from ggavatar.formats.splats.spz import MAX_SPZ_POSITION, write_spz
from ggavatar.formats.splats.stored_gaussians import StoredGaussians, to_stored
from ggavatar.formats.unbinding import binding_of, nearest_faces, unbind
from ggavatar.geometry.triangles import triangle_frames
from ggavatar.head.flame import JOINT_NAMES
from ggavatar.head.model import HeadModel
from ggavatar.training.run_folder import Run

WRITERS: Mapping[str, Callable[[Path, StoredGaussians], None]] = {
    "ply": write_gaussian_ply,
    "splat": write_splat,
    "spz": write_spz,
    "glb": write_glb,
}
"""Writers of our own formats."""
BOUND_FORMAT = "gaussian-avatars"
POINT_CLOUD_FILE = "point_cloud.ply"


class ExportResult(NamedTuple):
    """What an export wrote.

    Attributes:
        path: The file, or the folder of files.
        gaussians: Number of Gaussians in the file, or in the largest of them.
        notes: What the format cannot represent, and what its user must know.
    """

    path: Path
    gaussians: int
    notes: tuple[str, ...]


@torch.no_grad()
def export_splats(run: Run, drives: Sequence[NamedDrive], kind: str, path: Path, overwrite: bool) -> ExportResult:
    """Write the avatar as static splats: one drive to the file `path`, several to a folder of that name.

    Args:
        run: The avatar.
        drives: At least one.
        kind: One of `ggavatar.formats.splat_formats.splat_formats`.
        path: The file or folder to write.
        overwrite: Replace an earlier export.

    Raises:
        InputError: The output exists and must not be replaced.
    """
    write = splat_writer(kind)
    counts, notes = [], set()
    if len(drives) == 1:
        check_output_file(path, overwrite)
        rows = to_stored(run.avatar.gaussians(drives[0].drive))
        with output_file(path, overwrite):
            write(path, rows)
        return ExportResult(path, len(rows), tuple(format_losses(kind, rows)))
    with atomic_folder(path, overwrite) as folder:
        for name, drive in drives:
            rows = to_stored(run.avatar.gaussians(drive))
            write(folder / f"{name}.{kind}", rows)
            counts.append(len(rows))
            notes |= set(format_losses(kind, rows))
    return ExportResult(path, max(counts), tuple(sorted(notes)))


def splat_writer(kind: str) -> Callable[[Path, StoredGaussians], None]:
    """The writer of a format, ours or another package's; `InputError` if there is none or it cannot be used."""
    return WRITERS[kind] if kind in WRITERS else plugged_format(kind).write


def format_losses(kind: str, rows: StoredGaussians) -> list[str]:
    """What a splat format cannot represent."""
    if kind not in WRITERS:
        return plugged_format(kind).losses(rows)
    if kind == "splat" and np.any(rows.sh_rest):
        return [".splat cannot store view-dependent color, which is left out; .ply, .spz and .glb keep it"]
    far = int((np.abs(rows.means) > MAX_SPZ_POSITION).any(axis=1).sum()) if kind == "spz" else 0
    return (
        [f".spz cannot store positions beyond ±{MAX_SPZ_POSITION:g} m, {far} Gaussians are moved there"] if far else []
    )


@torch.no_grad()
def export_bound(run: Run, head: HeadModel, drive: Drive, folder: Path, overwrite: bool) -> ExportResult:
    """Write GaussianAvatars' layout: `point_cloud.ply` in the triangles' local frames, `flame_param.npz` of all frames.

    The layout represents nothing but the motion of the mesh. What a method adds to it (the offsets of an adjuster, a
    torso at rest) is stored as it is for `drive`.

    Args:
        run: The avatar.
        head: The head model of its capture.
        drive: Animates the head in which the Gaussians are bound to their triangles.
        folder: The folder to write.
        overwrite: Replace an earlier export.

    Raises:
        InputError: The head does not have FLAME's joints, or the output must not be replaced.
    """
    if head.joint_names[:5] != JOINT_NAMES:
        raise InputError(
            f"{run.folder}: expected a head with FLAME's joints {', '.join(JOINT_NAMES)}, found "
            f"{', '.join(head.joint_names)}; use --format ply"
        )
    gaussians = run.avatar.gaussians(drive)
    frames = triangle_frames(head.vertices(drive), head.faces)
    faces = binding_of(run.avatar, len(gaussians.means), len(head.faces))
    notes = _bound_losses(run, head)
    if faces is None:
        faces = nearest_faces(gaussians.means, frames)
        notes.append(f"{run.method} does not bind Gaussians to triangles; each was bound to the nearest triangle")
    rows = unbind(gaussians, faces, frames)
    with atomic_folder(folder, overwrite) as temporary:
        write_gaussian_ply(temporary / POINT_CLOUD_FILE, full_degree(rows))
        write_flame_parameters(temporary / PARAMETERS_FILE, _parameters(run), len(head.template))
    return ExportResult(folder, len(rows), tuple(notes))


def _parameters(run: Run) -> FlameParameters:
    """FLAME parameters of all frames of the capture."""
    tracking = run.capture.tracking
    shape = np.zeros(0) if tracking.shape is None else tracking.shape
    return FlameParameters(
        shape=shape.astype(np.float32),
        expression=tracking.expression.astype(np.float32),
        joint_rotations=tracking.joint_rotations[:, :5].astype(np.float32),
        translation=tracking.translation.astype(np.float32),
    )


def _bound_losses(run: Run, head: HeadModel) -> list[str]:
    """What GaussianAvatars' layout cannot represent of a run."""
    tracking = run.capture.tracking
    found = []
    if not head.version.startswith("flame"):
        found.append(
            f"the head is {head.version}, not FLAME: GaussianAvatars cannot animate it, ggavatar-render --capture can"
        )
    if np.any(tracking.eyelids):
        found.append("eyelids cannot be stored")
    if np.any(tracking.joint_rotations[:, 5:]):
        found.append("joints beyond FLAME's five cannot be stored")
    if tracking.shape is None:
        found.append("the capture has no identity coefficients; shape is zero")
    return found
