"""Notices images that are no longer those that were scored, by their digests. Does not import torch."""

from __future__ import annotations

from pathlib import Path

from evaluate.protocols.results import Evaluation
from evaluate.scoring.frame_store import changed_frames, folder_digest, read_digests
from ggavatar.errors import InputError


def changed_words(frames: tuple[int, ...]) -> str:
    """How many frames, and the first of them."""
    listed = ", ".join(map(str, frames[:5])) + (", …" if len(frames) > 5 else "")
    return f"images of {len(frames)} frame{'s' * (len(frames) > 1)} ({listed})"


def touched_images(evaluation: Evaluation, home: Path) -> list[str]:
    """Folders below an evaluation whose images are not those that were scored; empty if all are."""
    found = []
    for kind, sha256 in evaluation.hashes.items():
        region = kind.removeprefix("masks/")
        folder = kind if region == kind else "masks" if region == "foreground" else f"regions/{region}"
        if folder_digest(home / folder, evaluation.frames) != sha256:
            found.append(folder)
    return found


def require_untouched(evaluation: Evaluation, home: Path) -> None:
    """Raise `InputError` if the images beside stored scores are not those that were scored."""
    # Folders that are not there: images made elsewhere, or a copy of the scores alone.
    if touched := [name for name in touched_images(evaluation, home) if (home / name).is_dir()]:
        frames = tuple(sorted(changed_frames(read_digests(home), evaluation.frames)))
        which = f": {changed_words(frames)}" if frames else ""
        raise InputError(
            f"{home}: expected the images that were scored, found others (SHA-256) in {', '.join(touched)}{which}; "
            f"score them again: ggavatar-eval on the run, or on the pictures with --pred DIR --capture DIR"
        )
