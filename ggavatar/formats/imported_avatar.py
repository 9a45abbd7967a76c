"""Avatars made from files: Gaussians that stand still, and Gaussians bound to a head as GaussianAvatars has them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from ggavatar.core import Drive, Frame, Gaussians, Rendering
from ggavatar.data.capture import Capture
from ggavatar.errors import InputError
from ggavatar.formats.flame_parameters import FILE, FlameParameters, read_flame_parameters
from ggavatar.formats.flame_teeth import FLAME_FACES, FLAME_VERTICES, WITH_TEETH_FACES, with_teeth
from ggavatar.formats.gaussian_ply import read_gaussian_ply
from ggavatar.formats.source_options import GaussianFileOptions
from ggavatar.formats.stored_gaussians import Stored, activated
from ggavatar.gaussians.binding import bind
from ggavatar.geometry.triangles import triangle_frames
from ggavatar.head.files import load_head
from ggavatar.head.flame import JOINT_NAMES, is_flame, load_flame
from ggavatar.head.model import HeadModel

COLUMNS = ("means", "quats", "scales", "opacities", "colors")
EXPRESSIONS = 100
"""Of GaussianAvatars' FLAME, where no capture says otherwise."""


class ImportedAvatar(nn.Module):
    """Gaussians read from a file; they can be drawn, not trained."""

    def __init__(self, rows: Stored) -> None:
        super().__init__()
        read = activated(rows)
        for name in COLUMNS:
            self.register_buffer(name, getattr(read, name))

    def stored(self) -> Gaussians:
        """The Gaussians as the file places them."""
        means, quats, scales, opacities, colors = map(self.get_buffer, COLUMNS)
        return Gaussians(means, quats, scales, opacities, colors)

    def gaussians(self, drive: Drive) -> Gaussians:
        """The same for every drive: they stand in the world."""
        return self.stored()

    def losses(self, frame: Frame, rendering: Rendering, step: int) -> dict[str, Tensor]:
        """Nothing is learnt."""
        return {}

    def optimizers(self) -> list[torch.optim.Optimizer]:
        """Nothing is learnt."""
        return []

    def after_backward(self, rendering: Rendering, step: int) -> None:
        """Nothing is learnt."""


class BoundAvatar(ImportedAvatar):
    """Gaussians bound to the triangles of a head (GaussianAvatars, Sec. 3.2)."""

    faces: Tensor

    def __init__(self, rows: Stored, head: HeadModel, poses: Mapping[int, Drive]) -> None:
        """Bind the rows of a file.

        Args:
            rows: With `faces`, in units of their triangles.
            head: What they are bound to.
            poses: Drives that came with the file, by source frame number; they replace the capture's.
        """
        super().__init__(rows)
        assert rows.faces is not None
        self.register_buffer("faces", torch.from_numpy(rows.faces))
        self.head, self.poses = head, dict(poses)

    def gaussians(self, drive: Drive) -> Gaussians:
        """The Gaussians carried by the posed head; a frame that the file has parameters for is posed by these."""
        pose = drive if drive.frame is None else self.poses.get(drive.frame, drive)
        local = self.stored()
        frames = triangle_frames(self.head.vertices(pose), self.head.faces)
        placed = bind(local.means, local.quats, local.scales.log(), self.faces, frames)
        return Gaussians(*placed, local.opacities, local.colors)


def open_gaussians(
    path: Path, source: GaussianFileOptions, capture: Capture | None = None, device: torch.device | str = "cpu"
) -> ImportedAvatar:
    """A file of Gaussians as an avatar in evaluation mode.

    Args:
        path: Plain 3DGS, or GaussianAvatars' `point_cloud.ply`.
        source: What the file does not say itself.
        capture: Whose frames will be drawn.
        device: Where to draw.

    Raises:
        InputError: Not such a file, or it is bound to a head that was not given or does not fit.
    """
    rows = read_gaussian_ply(path, source.axes)
    if rows.faces is None:
        given = "--head-model" if source.head_model else "--flame-params" if source.flame_params else ""
        if given:
            raise InputError(f"{path}: has no binding_0, its Gaussians are bound to no head; leave out {given}")
        return ImportedAvatar(rows).to(device).eval()
    highest = int(rows.faces.max())
    head, parameters = _head(path, source, capture, highest)
    if highest >= len(head.faces):
        raise InputError(
            f"{path}: expected a head of at least {highest + 1} triangles, found {len(head.faces)}; give the one that "
            "the Gaussians were trained on with --head-model"
        )
    poses = {} if parameters is None or capture is None else _poses(path, parameters, head, capture)
    if capture is not None and not poses:
        _check_parameters(path, head, capture)
    head = head.to(device)
    moved = {number: _on(drive, device) for number, drive in poses.items()}
    return BoundAvatar(rows, head, moved).to(device).eval()


def _head(
    path: Path, source: GaussianFileOptions, capture: Capture | None, highest: int
) -> tuple[HeadModel, FlameParameters | None]:
    """The head that the Gaussians are bound to, and how the file poses it."""
    if source.head_model is None:
        if capture is None:
            raise InputError(
                f"{path}: its Gaussians are bound to a head; add --head-model FILE (flame2023.pkl for "
                "GaussianAvatars), or --capture DIR to use that of a capture"
            )
        parameters = read_flame_parameters(source.flame_params) if source.flame_params else None
        return load_head(capture.head_path), parameters
    beside = source.flame_params or path.parent / FILE
    parameters = read_flame_parameters(beside) if source.flame_params or beside.is_file() else None
    if not source.head_model.is_file():
        raise InputError(f"{source.head_model}: expected a head model file (.pkl or .npz), found none")
    if is_flame(source.head_model):
        return _flame(source.head_model, parameters, capture, highest), parameters
    return load_head(source.head_model), parameters


def _flame(path: Path, parameters: FlameParameters | None, capture: Capture | None, highest: int) -> HeadModel:
    """FLAME with the identity, offsets and, where Gaussians are bound to them, teeth of the file."""
    identity = parameters.shape if parameters else capture.tracking.shape if capture else None
    driven = capture is not None and parameters is None
    count = capture.tracking.expression.shape[1] if capture is not None and driven else EXPRESSIONS
    head = load_flame(path, identity, expressions=count)
    if FLAME_FACES <= highest < WITH_TEETH_FACES and (len(head.template), len(head.faces)) == (
        FLAME_VERTICES,
        FLAME_FACES,
    ):
        head = with_teeth(load_flame(path, expressions=count), head)
    if parameters is None or parameters.offset is None:
        return head
    offset = np.zeros(head.template.shape, np.float32)
    used = min(len(offset), len(parameters.offset))
    offset[:used] = parameters.offset[:used]
    return dataclasses.replace(head, template=head.template + torch.from_numpy(offset))


def _poses(path: Path, parameters: FlameParameters, head: HeadModel, capture: Capture) -> dict[int, Drive]:
    """Drives by source frame number: timestep k is the capture's k-th frame, or the frame of number k."""
    if head.joint_names[:5] != JOINT_NAMES:
        raise InputError(f"{path}: expected a head with FLAME's joints, found {', '.join(head.joint_names[:5])}")
    drives = parameters.drives(head)
    if len(drives) == len(capture.frames):
        return dict(zip(capture.frames, drives, strict=True))
    if len(drives) > capture.frames[-1]:
        return {number: drives[number] for number in capture.frames}
    raise InputError(
        f"{path}: its parameters have {len(drives)} timesteps, {capture.folder} has {len(capture.frames)} frames up "
        f"to number {capture.frames[-1]}; give the capture of the video it was trained on"
    )


def _check_parameters(path: Path, head: HeadModel, capture: Capture) -> None:
    """The capture's parameters must be those of the head."""
    own = (head.version, head.expression_basis.shape[2], len(head.parents))
    tracking = capture.tracking
    theirs = (capture.head_version, tracking.expression.shape[1], tracking.joint_rotations.shape[1])
    if own != theirs:
        raise InputError(
            f"{path}: expected parameters of the head {own[0]} ({own[1]} expressions, {own[2]} joints), the capture "
            f"has those of {theirs[0]} ({theirs[1]}, {theirs[2]}); they mean different things. Add --flame-params "
            "FILE, or prepare the capture with this head model"
        )


def _on(drive: Drive, device: torch.device | str) -> Drive:
    """The same drive on a device."""
    moved: dict = {name: value.to(device) for name, value in vars(drive).items() if isinstance(value, Tensor)}
    return dataclasses.replace(drive, **moved)
