"""Avatars read from files: static Gaussians, and Gaussians bound to a head model (GaussianAvatars' layout)."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from ggavatar.core import Drive, Frame, Gaussians, Rendering
from ggavatar.data.capture import Capture
from ggavatar.errors import InputError
from ggavatar.formats.flame_parameters import PARAMETERS_FILE, FlameParameters, read_flame_parameters
from ggavatar.formats.flame_teeth import FLAME_FACES, FLAME_VERTICES, WITH_TEETH_FACES, with_teeth
from ggavatar.formats.gaussian_files import read_gaussians
from ggavatar.formats.source_options import GaussianFileOptions
from ggavatar.formats.splats.stored_gaussians import StoredGaussians, activate
from ggavatar.gaussians.binding import bind
from ggavatar.geometry.triangles import triangle_frames
from ggavatar.head.files import load_head
from ggavatar.head.flame import JOINT_NAMES, is_flame, load_flame
from ggavatar.head.model import HeadModel
from ggavatar.text.terminal import write_err

BUFFERS = ("means", "quats", "scales", "opacities", "colors")
DEFAULT_EXPRESSIONS = 100
"""Expression coefficients of GaussianAvatars' FLAME, used unless a capture needs another number."""


class ImportedAvatar(nn.Module):
    """Static Gaussians read from a file; they can be rendered but not trained."""

    def __init__(self, rows: StoredGaussians) -> None:
        super().__init__()
        gaussians = activate(rows)
        for name in BUFFERS:
            self.register_buffer(name, getattr(gaussians, name))

    def file_gaussians(self) -> Gaussians:
        """The Gaussians as in the file."""
        means, quats, scales, opacities, colors = map(self.get_buffer, BUFFERS)
        return Gaussians(means, quats, scales, opacities, colors)

    def gaussians(self, drive: Drive) -> Gaussians:
        """The Gaussians as in the file, whatever the drive."""
        return self.file_gaussians()

    def losses(self, frame: Frame, rendering: Rendering, step: int) -> dict[str, Tensor]:
        """No losses: the avatar is not trained."""
        return {}

    def optimizers(self) -> list[torch.optim.Optimizer]:
        """No optimizers: the avatar is not trained."""
        return []

    def after_backward(self, rendering: Rendering, step: int) -> None:
        """Do nothing: the avatar is not trained."""


class BoundAvatar(ImportedAvatar):
    """Gaussians bound to the triangles of a head (GaussianAvatars, Sec. 3.2)."""

    faces: Tensor

    def __init__(self, rows: StoredGaussians, head: HeadModel, drives: Mapping[int, Drive]) -> None:
        """Bind the Gaussians of a file to a head.

        Args:
            rows: With `faces`, in the units of their triangles.
            head: The head that they are bound to.
            drives: Drives from the parameters of the file, by source frame number; they replace the capture's.
        """
        super().__init__(rows)
        assert rows.faces is not None
        self.register_buffer("faces", torch.from_numpy(rows.faces))
        self.head, self.drives = head, dict(drives)

    def gaussians(self, drive: Drive) -> Gaussians:
        """The Gaussians on the animated head; frames that the file has parameters for use these."""
        used = drive if drive.frame is None else self.drives.get(drive.frame, drive)
        local = self.file_gaussians()
        frames = triangle_frames(self.head.vertices(used), self.head.faces)
        placed = bind(local.means, local.quats, local.scales.log(), self.faces, frames)
        return Gaussians(*placed, local.opacities, local.colors)


def open_gaussians(
    path: Path, source: GaussianFileOptions, capture: Capture | None = None, device: torch.device | str = "cpu"
) -> ImportedAvatar:
    """A file of Gaussians as an avatar in evaluation mode; what was assumed of it is said on stderr.

    Args:
        path: Any file of Gaussians, or GaussianAvatars' `point_cloud.ply`.
        source: What the file does not contain.
        capture: The capture whose frames will be rendered.
        device: Device of the avatar.

    Raises:
        InputError: The file is of another kind, or it is bound to a head that was not given or does not match.
    """
    rows = read_gaussians(path, source)
    for note in rows.notes:
        write_err(f"note: {path}: {note}")
    if rows.faces is None:
        given = "--head-model" if source.head_model else "--flame-params" if source.flame_params else ""
        if given:
            raise InputError(f"{path}: expected Gaussians bound to a head, found no binding_0; leave out {given}")
        return ImportedAvatar(rows).to(device).eval()
    highest = int(rows.faces.max())
    head, parameters = _head(path, source, capture, highest)
    if highest >= len(head.faces):
        raise InputError(
            f"{path}: expected a head of at least {highest + 1} triangles, found {len(head.faces)}; pass the one that "
            "the Gaussians were trained on with --head-model"
        )
    drives = {} if parameters is None or capture is None else _drives_by_frame(path, parameters, head, capture)
    if capture is not None and not drives:
        _check_head(path, head, capture)
    head = head.to(device)
    drives = {number: _to_device(drive, device) for number, drive in drives.items()}
    return BoundAvatar(rows, head, drives).to(device).eval()


def _head(
    path: Path, source: GaussianFileOptions, capture: Capture | None, highest: int
) -> tuple[HeadModel, FlameParameters | None]:
    """The head that the Gaussians are bound to, and its parameters in the training frames, if there are any."""
    if source.head_model is None:
        if capture is None:
            raise InputError(
                f"{path}: expected the head that its Gaussians are bound to, found none; add --head-model FILE "
                "(flame2023.pkl for GaussianAvatars), or --capture DIR to use the head of a capture"
            )
        parameters = read_flame_parameters(source.flame_params) if source.flame_params else None
        return load_head(capture.head_path), parameters
    beside = source.flame_params or path.parent / PARAMETERS_FILE
    parameters = read_flame_parameters(beside) if source.flame_params or beside.is_file() else None
    if not source.head_model.is_file():
        raise InputError(f"{source.head_model}: expected a head model file (.pkl or .npz), found no such file")
    if is_flame(source.head_model):
        return _flame(source.head_model, parameters, capture, highest), parameters
    return load_head(source.head_model), parameters


def _flame(path: Path, parameters: FlameParameters | None, capture: Capture | None, highest: int) -> HeadModel:
    """FLAME with the identity and offsets of the file, and with teeth if Gaussians are bound to them."""
    identity = parameters.shape if parameters else capture.tracking.shape if capture else None
    driven = capture is not None and parameters is None
    count = capture.tracking.expression.shape[1] if capture is not None and driven else DEFAULT_EXPRESSIONS
    head = load_flame(path, identity, expressions=count)
    is_without_teeth = (len(head.template), len(head.faces)) == (FLAME_VERTICES, FLAME_FACES)
    if is_without_teeth and FLAME_FACES <= highest < WITH_TEETH_FACES:
        head = with_teeth(load_flame(path, expressions=count), head)
    if parameters is None or parameters.offset is None:
        return head
    offset = np.zeros(head.template.shape, np.float32)
    used = min(len(offset), len(parameters.offset))
    offset[:used] = parameters.offset[:used]
    return dataclasses.replace(head, template=head.template + torch.from_numpy(offset))


def _drives_by_frame(path: Path, parameters: FlameParameters, head: HeadModel, capture: Capture) -> dict[int, Drive]:
    """Drives by source frame number: timestep k is the k-th frame of the capture, or the frame with number k."""
    if head.joint_names[:5] != JOINT_NAMES:
        raise InputError(f"{path}: expected a head with FLAME's joints, found {', '.join(head.joint_names[:5])}")
    drives = parameters.drives(head)
    if len(drives) == len(capture.frames):
        return dict(zip(capture.frames, drives, strict=True))
    if len(drives) > capture.frames[-1]:
        return {number: drives[number] for number in capture.frames}
    raise InputError(
        f"{path}: expected parameters of {len(capture.frames)} timesteps, or of all frames up to number "
        f"{capture.frames[-1]}, as {capture.folder} has them, found {len(drives)} timesteps; pass the capture of the "
        "video it was trained on"
    )


def _check_head(path: Path, head: HeadModel, capture: Capture) -> None:
    """Raise an `InputError` if the capture was tracked with another head model."""
    own = (head.version, head.expression_basis.shape[2], len(head.parents))
    tracking = capture.tracking
    tracked = (capture.head_version, tracking.expression.shape[1], tracking.joint_rotations.shape[1])
    if own != tracked:
        raise InputError(
            f"{path}: expected a capture tracked with the head {own[0]} ({own[1]} expressions, {own[2]} joints), found "
            f"{tracked[0]} ({tracked[1]}, {tracked[2]}), whose parameters differ in meaning; add --flame-params FILE, "
            "or prepare the capture with this head model"
        )


def _to_device(drive: Drive, device: torch.device | str) -> Drive:
    """The same drive on a device."""
    moved: dict[str, Any] = {name: value.to(device) for name, value in vars(drive).items() if isinstance(value, Tensor)}
    return dataclasses.replace(drive, **moved)
