"""Performances: somebody's face, or curves of ARKit's names, as an avatar performs them."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, TypedDict, Unpack

import numpy as np

from ggavatar.api.options import check_options
from ggavatar.data.capture import Capture
from ggavatar.errors import InputError, nearest
from ggavatar.formats.arkit_recording import ARKIT_NAMES
from ggavatar.formats.driving_options import DrivingOptions
from ggavatar.formats.performances import CarriedOver, carried_over
from ggavatar.io.npz import write_npz
from ggavatar.training.run_folder import Run

Performance = CarriedOver
"""A performance in an avatar's own parameters: `frames`, `drives`, `cameras`, `fps`."""
Curve = Sequence[float] | np.ndarray
"""One score over time, from 0 to 1."""
FPS = 25.0
"""Frame rate of curves, frames per second, if it is not said."""


class DriveOptions(TypedDict, total=False):
    """How a performance is carried over to an avatar (docs/driving.md)."""

    transfer: Literal["matched", "relative", "absolute"]
    """matched (what the faces show), relative or absolute (coefficients)."""
    pose: Literal["relative", "absolute", "still"]
    """relative, absolute or still."""
    smooth: Literal["none", "one-euro", "savgol"]
    """none, one-euro or savgol."""
    limit: float
    """How far a coefficient may leave the range seen in training, as a fraction of it; negative: no limit."""
    driver_neutral: int
    """Frame number that shows the driver at rest."""
    target_neutral: int
    """Frame number that shows the avatar's subject at rest."""
    force_basis: bool
    """Accept another number of coefficients or another version of the same family of bases."""
    fps: float
    """Frame rate of curves, 25 if not given; what is performed has 30 frames per second."""


def drive(run: Run, source: Capture | Path | str | Mapping[str, Curve], **options: Unpack[DriveOptions]) -> Performance:
    """Have an avatar perform what a source shows, as `ggavatar-render --drive` does.

    Args:
        run: The avatar.
        source: A capture, a file of head parameters, a recording of ARKit's or MediaPipe's scores, or curves: lists of
            one length with values from 0 to 1, by ARKit's names, such as `{"jawOpen": [0, 0.5, 1]}`; names that are
            left out are at rest.
        **options: As in `DriveOptions`.

    Raises:
        InputError: The source cannot be read or does not fit the avatar.
    """
    check_options("drive", options, DriveOptions)
    given: dict[str, Any] = dict(options)
    fps = float(given.pop("fps", FPS))
    if not fps > 0:
        raise InputError(f"drive(fps=…): expected frames per second above 0, found {fps:g}")
    how = DrivingOptions(**given)
    if isinstance(source, Capture):
        return carried_over(run, source.folder, how)
    if not isinstance(source, Mapping):
        return carried_over(run, Path(source), how)
    with tempfile.TemporaryDirectory() as folder:
        return carried_over(run, _recording(Path(folder) / "curves.npz", source, fps), how)


def _recording(path: Path, curves: Mapping[str, Curve], fps: float) -> Path:
    """The curves as a recording that every command opens."""
    for name in curves:
        if name not in ARKIT_NAMES:
            raise InputError(f"expected ARKit's names, such as jawOpen, found {name!r}{nearest(name, ARKIT_NAMES)}")
    lengths = {len(curve) for curve in curves.values()}
    if len(lengths) != 1 or not min(lengths):
        raise InputError(f"expected curves of one length of 1 or more, found {sorted(lengths) or 'none'}")
    scores = np.zeros((lengths.pop(), len(ARKIT_NAMES)))
    for name, curve in curves.items():
        scores[:, ARKIT_NAMES.index(name)] = curve
    write_npz(path, {"names": np.array(ARKIT_NAMES), "scores": scores, "fps": np.array(fps)})
    return path
