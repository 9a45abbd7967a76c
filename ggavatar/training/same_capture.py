"""Whether a capture is the one that a run began on, by its contents and not by its place."""

from __future__ import annotations

from pathlib import Path

from ggavatar.data.capture import Capture
from ggavatar.errors import InputError
from ggavatar.io.json_files import read_json
from ggavatar.training.run_folder import Run, RunConfig, capture_places


def require_same_capture(run: Path, config: RunConfig, capture: Capture, digest: str) -> None:
    """Check that a run is continued, or counted as trained, on the capture that it began on, wherever that is now.

    Args:
        run: The run folder.
        config: Its configuration.
        capture: The capture that the user names.
        digest: `capture.digest()`.

    Raises:
        InputError: Another capture, or one that has changed since.
    """
    recorded = recorded_digest(run)
    if recorded == digest:
        return
    here = capture.folder.resolve()
    is_same_place = any(place.resolve() == here for place in capture_places(run, config))
    if is_same_place and recorded is None:  # stopped before its first step, which is what begins
        return
    if is_same_place:
        raise InputError(
            f"{run}: {capture.folder} has changed since the training began; restore it, or choose another folder with "
            "-o"
        )
    other = ", which has other contents" if recorded is not None else ""
    raise InputError(
        f"{run}: was trained on {config.capture}, not on {capture.folder}{other}; choose another folder with -o"
    )


def change_since_training(run: Run) -> str | None:
    """One line if the capture of an opened run is no longer the one that it was trained on; reads all images."""
    recorded = run.provenance.get("capture_sha256")
    if recorded is None or recorded == run.capture.digest():
        return None
    return f"{run.capture.folder} has changed since {run.folder} was trained on it; the avatar may not fit it any more"


def recorded_digest(run: Path) -> str | None:
    """The digest of the capture that the training recorded when it began; None if it was stopped before."""
    try:
        return str(read_json(run / "provenance.json")["capture_sha256"])
    except (InputError, KeyError):
        return None
