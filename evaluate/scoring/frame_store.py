"""The images of an evaluation on disk, with a digest of each, so that a changed file is never taken for our own.

Predictions, ground truth and masks are 8-bit images named by source frame number. `SHA256SUMS` holds the digest of each
(`sha256sum -c SHA256SUMS` checks them), `predict.json` says what they are images of.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from evaluate.scoring.frame_files import frame_file, frame_files
from evaluate.scoring.ground_truth import GroundTruth, ImageSource
from ggavatar.errors import InputError
from ggavatar.io.atomic import write_text
from ggavatar.io.digests import sha256_of
from ggavatar.io.images import write_png
from ggavatar.io.json_files import digest_of, read_json, write_sealed_json
from ggavatar.io.regular_files import read_file

FOLDERS = ("predictions", "ground_truth", "masks")
SUMMARY, SUMS = "predict.json", "SHA256SUMS"
MAX_SUMS_BYTES = 1 << 26

Progress = Callable[[int, int], None]
Recorded = dict[tuple[str, int], tuple[Path, str]]


@dataclass(frozen=True)
class PredictionTask:
    """What is predicted, and what identifies the files of an earlier call as reusable.

    Attributes:
        frames: Source frame numbers in rendering order.
        truth: Background and size of predictions and ground truth.
        identity: Plain values that must match for existing files to be reused: method, step, capture and so on.
    """

    frames: tuple[int, ...]
    truth: GroundTruth
    identity: dict[str, Any]

    def described(self) -> dict[str, Any]:
        """All fields as plain JSON values."""
        size = list(self.truth.size) if self.truth.size else None
        content = {"background": list(self.truth.background), "size": size, "binary_mask": self.truth.binary_mask}
        return {**content, "frames": sorted(self.frames), "identity": self.identity}

    def key(self) -> str:
        """SHA-256 of `described` as JSON with sorted keys."""
        return digest_of(self.described())


@dataclass(frozen=True)
class Filled:
    """What a folder of images holds after `fill_frames`.

    Attributes:
        summary: The content of `predict.json`.
        written: Frames whose images this call wrote.
        changed: Those among them whose files somebody had changed since they were written.
    """

    summary: dict[str, Any]
    written: tuple[int, ...]
    changed: tuple[int, ...]


def fill_frames(
    folder: Path,
    task: PredictionTask,
    capture: ImageSource,
    write_prediction: Callable[[int, tuple[int, int]], Path],
    expected: Mapping[int, str] | None = None,
    progress: Progress | None = None,
) -> Filled:
    """Write the images of every frame that is missing or no longer what was written, and start `predict.json`.

    Args:
        folder: Output folder; created if missing.
        task: Frames, background and identity.
        capture: Source of ground truth and masks.
        write_prediction: Writes the prediction of a frame, at (width, height) px, below `folder` and returns its path.
        expected: SHA-256 that the predictions must have, by frame, if it is known beforehand.
        progress: Called with (done, total) before the first and after every frame.

    Raises:
        InputError: The folder contains other images than those of this task, or the task has no frames.
    """
    if not task.frames:
        raise InputError("expected at least one frame to render, found none; choose another split or protocol")
    summary = _claim_folder(folder, task)
    recorded = read_digests(folder)
    changed = changed_frames(recorded, task.frames)
    intact = {n for n in task.frames if n not in changed and _is_complete(recorded, n, expected)}
    missing = [number for number in task.frames if number not in intact]
    report = progress or (lambda done, total: None)
    report(len(intact), len(task.frames))
    if missing:
        _tidy_digests(folder)  # a line cut off by an interruption must not swallow the next one
    for done, number in enumerate(missing, start=len(intact) + 1):
        image, mask = task.truth.image_and_mask(capture, number)
        paths = [write_prediction(number, (image.shape[1], image.shape[0]))]
        for name, pixels in zip(FOLDERS[1:], (image, mask), strict=True):
            paths.append(frame_file(folder / name, number))
            write_png(paths[-1], pixels)
        _record(folder, paths)
        report(done, len(task.frames))
    if missing:
        _tidy_digests(folder)
    return Filled(summary, tuple(missing), tuple(sorted(changed)))


def read_digests(folder: Path) -> Recorded:
    """Path and SHA-256 by (subfolder, frame) as recorded; a line cut off by an interruption is skipped."""
    path = folder / SUMS
    text = read_file(path, MAX_SUMS_BYTES).decode("utf-8", errors="replace") if path.is_file() else ""
    found: Recorded = {}
    for line in text.splitlines():
        if match := re.fullmatch(r"([0-9a-f]{64}) [ *]((\w+)/(\d+)\.\w+)", line):
            found[match[3], int(match[4])] = folder / match[2], match[1]
    return found


def changed_frames(recorded: Recorded, frames: Sequence[int]) -> set[int]:
    """Frames with a file that is there but not what was written."""
    files = (recorded[key] for key in recorded if key[1] in set(frames))
    return {int(path.stem) for path, sha256 in files if path.is_file() and sha256_of(path) != sha256}


def _is_complete(recorded: Recorded, number: int, expected: Mapping[int, str] | None) -> bool:
    """Whether all images of a frame are recorded and there, the prediction with the expected digest."""
    entries = [recorded.get((name, number)) for name in FOLDERS]
    if any(entry is None or not entry[0].is_file() for entry in entries):
        return False
    return expected is None or (entries[0] is not None and entries[0][1] == expected[number])


def _record(folder: Path, paths: Sequence[Path]) -> None:
    lines = (f"{sha256_of(path)}  {path.relative_to(folder).as_posix()}\n" for path in paths)
    with (folder / SUMS).open("a", encoding="utf-8", newline="\n") as stream:
        stream.write("".join(lines))


def _tidy_digests(folder: Path) -> None:
    """Rewrite the record in the order of folders and frames, without what later lines replace."""
    recorded = sorted(read_digests(folder).items())
    lines = (f"{sha256}  {path.relative_to(folder).as_posix()}\n" for _, (path, sha256) in recorded)
    write_text(folder / SUMS, "".join(lines))


def folder_digest(folder: Path, frames: Sequence[int]) -> str | None:
    """SHA-256 over the lines `FRAME SHA256-OF-FILE`, as in `hashes` of metrics.json; None if a frame is missing."""
    try:
        files = frame_files(folder)
    except InputError:
        return None
    if not set(frames) <= set(files):
        return None
    lines = (f"{number} {sha256_of(files[number])}\n" for number in frames)
    return hashlib.sha256("".join(lines).encode()).hexdigest()


def _claim_folder(folder: Path, task: PredictionTask) -> dict[str, Any]:
    """Start a summary in the folder, or return the one of an earlier call for this task."""
    path = folder / SUMMARY
    if path.is_file():
        return _read_summary(path, task)
    if folder.is_dir() and any((folder / name).exists() for name in FOLDERS):
        raise InputError(
            f"{folder}: expected no images, found some of unknown origin (no {SUMMARY}); choose another -o"
        )
    summary: dict[str, Any] = {
        "schema": "ggavatar-predictions",
        "version": 1,
        "key": task.key(),
        **task.described(),
        "complete": False,
    }
    write_sealed_json(path, summary)
    return summary


def _read_summary(path: Path, task: PredictionTask) -> dict[str, Any]:
    """The summary at `path`; `InputError` if it was written for another task."""
    try:
        summary = read_json(path)
        key, complete = summary["key"], bool(summary["complete"])
    except (InputError, KeyError) as error:
        raise InputError(
            f"{path}: expected a summary of predictions, found something else ({error}); choose another -o"
        ) from error
    if key != task.key():
        wanted = task.described()
        changed = [name for name, value in wanted.items() if summary.get(name) != value]
        raise InputError(
            f"{path.parent}: contains predictions that differ from those requested in "
            f"{', '.join(changed) or 'their key'} "
            f"(found {[summary.get(name) for name in changed][:3]}); choose another -o or delete the folder"
        )
    return {**summary, "complete": complete}
