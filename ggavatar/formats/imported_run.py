"""A file of Gaussians together with a capture as a `Run`, so that it is drawn and measured like any other."""

from __future__ import annotations

import hashlib
from pathlib import Path

import torch

from ggavatar.data.capture import Capture
from ggavatar.data.frames import Frames
from ggavatar.errors import InputError
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
        source: With a capture.
        split: Name or rule of the split that is drawn and scored. Which frames the file was trained on is not known.
        device: Where to draw.
        backend: The rasteriser.

    Raises:
        InputError: Not a file of Gaussians, no capture, or one that does not fit.
    """
    if source.capture is None:
        raise InputError(f"{path}: expected the cameras and pictures of a capture; add --capture DIR")
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
        split=chosen,
        background=background,
        rasterize=pick(device, backend),
        config=RunConfig(method, str(capture.folder.resolve()), name, WHITE, device=device, backend=backend),
        provenance={"file": str(path), "file_sha256": file_digest(path)},
        step=0,
        reader=Frames(capture, head, background, device),
    )


def file_digest(path: Path) -> str:
    """SHA-256 of a file."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
