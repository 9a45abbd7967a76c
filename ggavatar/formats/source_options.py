"""Flags for opening a file of Gaussians in place of a run, which several commands share. Does not import torch."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

SUFFIX = ".ply"


@dataclass(frozen=True)
class GaussianFileOptions:
    """What a file of Gaussians (FILE.ply in place of a run) does not contain."""

    capture: Path | None = None
    """With FILE.ply: the capture whose frames, cameras and head are used; with a run: where its capture is now; with
    ggavatar-eval --pred: the capture that the pictures show."""
    head_model: Path | None = None
    """With FILE.ply bound to triangles (GaussianAvatars): flame2023.pkl, generic_model.pkl or an .npz; the capture's
    head if not given."""
    flame_params: Path | None = None
    """With --head-model: FLAME parameters of all frames; flame_param.npz beside FILE.ply if not given."""
    axes: Literal["auto", "world", "viewer"] = "auto"
    """Axes of FILE.ply: world (as trained) or viewer (y down); auto recognizes files of ggavatar-export, else world."""


def is_gaussian_file(path: Path) -> bool:
    """Whether a command-line argument names a file of Gaussians rather than a run."""
    return path.suffix.lower() == SUFFIX and not path.is_dir()


def results_folder(path: Path) -> Path:
    """Folder for results of a run or of a file of Gaussians: the run itself, or a folder beside the file."""
    return path.with_suffix("") if is_gaussian_file(path) else path
