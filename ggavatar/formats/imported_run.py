"""A file of Gaussians and a capture as a `Run`, so that it is rendered and evaluated like any other run."""

from __future__ import annotations

from pathlib import Path

import torch

from ggavatar.data.capture import Capture
from ggavatar.data.frames import Frames
from ggavatar.errors import InputError
from ggavatar.formats.gaussian_files import digest
from ggavatar.formats.imported_avatar import BoundAvatar, open_gaussians
from ggavatar.formats.source_options import GaussianFileOptions, results_folder
from ggavatar.head.files import load_head
from ggavatar.render.backends import pick
from ggavatar.training.run_folder import Run, RunConfig, choose_split

WHITE = (1.0, 1.0, 1.0)
DEFAULT_SPLIT = "every-20th"


def open_imported_run(
    path: Path, source: GaussianFileOptions, split: str = DEFAULT_SPLIT, device: str = "cpu", backend: str = "auto"
) -> Run:
    """Open a file of Gaussians as if it were a run on a capture.

    Args:
        path: The file.
        source: Names the capture.
        split: Name or rule of the split that is rendered and scored; the frames of the training are unknown.
        device: Device of the avatar.
        backend: The rasterizer, as in `ggavatar.render.backends`.

    Raises:
        InputError: The file does not hold Gaussians, there is no capture, or the two do not match.
    """
    if source.capture is None:
        raise InputError(f"{path}: expected a capture with cameras and frames, found none; add --capture DIR")
    capture = Capture.open(source.capture)
    avatar = open_gaussians(path, source, capture, device)
    name, chosen = choose_split(capture, split)
    head = load_head(capture.head_path).to(device, torch.float32)
    background = torch.tensor(WHITE, device=device)
    method = "GaussianAvatars file" if isinstance(avatar, BoundAvatar) else "3DGS file"
    return Run(
        folder=results_folder(path),
        method=method,
        avatar=avatar,
        capture=capture,
        head=head,
        split=chosen,
        background=background,
        rasterize=pick(device, backend),
        config=RunConfig(method, str(capture.folder.resolve()), name, WHITE, device=device, backend=backend),
        provenance={"file": str(path), "file_sha256": digest(path)},
        step=0,
        sha256=digest(path),
        reader=Frames(capture, head, background, device),
    )
