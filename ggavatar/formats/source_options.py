"""How a file of Gaussians is opened in place of a run: flags that the commands share. Starts without torch."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

SUFFIX = ".ply"


@dataclass(frozen=True)
class GaussianFileOptions:
    """What a file of Gaussians (FILE.ply in place of a run) does not say itself."""

    capture: Path | None = None
    """With FILE.ply: the capture whose frames, cameras and head are used; with a run: where its capture lies now."""
    head_model: Path | None = None
    """With FILE.ply bound to triangles (GaussianAvatars): flame2023.pkl, generic_model.pkl or an .npz; the capture's
    head if not given."""
    flame_params: Path | None = None
    """With --head-model: how FLAME was posed; flame_param.npz beside FILE.ply if not given."""
    axes: Literal["auto", "world", "viewer"] = "auto"
    """Of FILE.ply: world as trained, viewer as turned for viewers (y down); auto knows files of ggavatar-export."""


def is_gaussian_file(path: Path) -> bool:
    """Whether a command-line argument names a file of Gaussians rather than a run."""
    return path.suffix.lower() == SUFFIX and not path.is_dir()


def results_folder(path: Path) -> Path:
    """Where what is made from a run or a file of Gaussians goes: the run itself, or a folder beside the file."""
    return path.with_suffix("") if is_gaussian_file(path) else path
