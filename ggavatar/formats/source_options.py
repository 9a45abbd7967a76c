"""Flags for opening a file of Gaussians in place of a run, which several commands share. Does not import torch."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from ggavatar.formats.splats.file_kinds import file_kind


@dataclass(frozen=True)
class GaussianReadingOptions:
    """How the numbers of a file of Gaussians are meant, where it does not say so itself."""

    axes: Literal["auto", "world", "viewer"] = "auto"
    """Axes of FILE: world (as trained) or viewer (y down); auto means viewer for .splat, SOG, compressed PLY and the
    PLY of ggavatar-export, else world."""
    scales: Literal["auto", "log", "linear"] = "auto"
    """Scales of FILE.ply: logarithms (as of 3DGS) or lengths; auto decides by the values."""
    opacities: Literal["auto", "logit", "linear"] = "auto"
    """Opacities of FILE.ply: logits (as of 3DGS) or 0 to 1; auto decides by the values."""

    @property
    def are_given(self) -> bool:
        """Whether any differs from its default."""
        return (self.axes, self.scales, self.opacities) != ("auto", "auto", "auto")


@dataclass(frozen=True)
class GaussianFileOptions(GaussianReadingOptions):
    """What a file of Gaussians (FILE in place of a run) does not contain."""

    capture: Path | None = None
    """With FILE: the capture whose frames, cameras and head are used; with a run: where its capture is now; with
    ggavatar-eval --pred: the capture that the pictures show."""
    head_model: Path | None = None
    """With FILE.ply bound to triangles (GaussianAvatars): flame2023.pkl, generic_model.pkl or an .npz; the capture's
    head if not given."""
    flame_params: Path | None = None
    """With --head-model: FLAME parameters of all frames; flame_param.npz beside FILE.ply if not given."""


def is_gaussian_file(path: Path) -> bool:
    """Whether a command-line argument names a file of Gaussians rather than a run."""
    return file_kind(path) is not None


def results_folder(path: Path) -> Path:
    """Folder for results of a run or of a file of Gaussians: the run itself, or a folder beside the file.

    The results of a SOG in a folder are in that folder.
    """
    kind = None if path.is_dir() else file_kind(path)
    if kind is None:
        return path
    if kind == "sog" and path.suffix == ".json":
        return path.parent
    return path.with_suffix("") if path.suffix else path.with_name(f"{path.name}-results")
