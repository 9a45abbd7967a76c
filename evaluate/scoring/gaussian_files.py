"""A file of Gaussians in place of a run folder, rendered and scored with a capture's cameras."""

from __future__ import annotations

from pathlib import Path

from evaluate.protocols.protocol import GIVEN
from ggavatar.data.capture import Capture
from ggavatar.errors import InputError
from ggavatar.formats.imported_run import DEFAULT_SPLIT, open_imported_run
from ggavatar.formats.source_options import GaussianFileOptions
from ggavatar.training.run_folder import Run


def open_gaussian_file(path: Path, source: GaussianFileOptions, split: str, device: str, backend: str = "auto") -> Run:
    """Open a file of Gaussians as a run; if the protocol leaves the split open, the capture's is used.

    Raises:
        InputError: Not a file of Gaussians, or no matching capture.
    """
    if split in (GIVEN, "file") and source.capture is not None:
        known = Capture.open(source.capture).splits
        split = "file" if "file" in known else DEFAULT_SPLIT
    return open_imported_run(path, source, split, device, backend)


def refuse_file_flags(path: Path, source: GaussianFileOptions) -> None:
    """Raise `InputError` if options for files of Gaussians are combined with a run."""
    if source.head_model or source.flame_params or source.are_given:
        raise InputError(
            f"{path}: --head-model, --flame-params, --axes, --scales and --opacities belong to a file of Gaussians, "
            "this is a run; omit them"
        )
