"""Opening an avatar, whatever holds it: a run folder or an avatar file. What every command and viewer uses."""

from __future__ import annotations

from pathlib import Path

from ggavatar.errors import InputError
from ggavatar.formats.avatar_file.reader import open_avatar_file
from ggavatar.formats.avatar_suffix import is_avatar_file
from ggavatar.training.run_folder import Run, open_run


def open_avatar(
    path: Path, device: str = "cpu", step: int | None = None, backend: str = "auto", capture: Path | None = None
) -> Run:
    """A run folder, or a file of `ggavatar-export RUN --format avatar`, as a `Run`.

    The run of an avatar file has a capture without images (`CaptureWithoutImages`): it is rendered, driven and
    exported like any other, and what needs a photograph of it is refused by name.

    Args:
        path: Run folder or avatar file.
        device: Device of the avatar.
        step: Step of the checkpoint of a run; None is the newest.
        backend: The rasterizer, as in `ggavatar.render.backends`.
        capture: New location of the capture of a run, if it was moved.

    Raises:
        InputError: Neither of the two, damaged, or a file with `step` or `capture`.
    """
    if not is_avatar_file(path):
        return open_run(path, device, step, backend, capture)
    if step is not None:
        raise InputError(f"{path}: an avatar file holds one step of the training; leave out --step")
    if capture is not None:
        raise InputError(f"{path}: an avatar file needs no capture; leave out --capture, or open the run instead")
    return open_avatar_file(path, device, backend)
