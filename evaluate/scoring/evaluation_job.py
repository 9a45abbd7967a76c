"""Scores the images of one evaluation folder, and reuses what is there only if its digests still match."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, runtime_checkable
from typing import Protocol as Interface

from evaluate.metrics.network_files import NO_WEIGHTS
from evaluate.options import Options
from evaluate.protocols.protocol import Protocol
from evaluate.protocols.results import (
    FRAMES_FILE,
    METRICS_FILE,
    Evaluation,
    read_results,
    restore_frames,
    write_results,
)
from evaluate.scoring.accumulator import Labels
from evaluate.scoring.frame_pairs import pair_folders
from evaluate.scoring.frame_store import (
    FOLDERS,
    SUMMARY,
    SUMS,
    Filled,
    PredictionTask,
    Progress,
    read_digests,
)
from evaluate.scoring.region_masks import FrameReader, write_region_masks
from evaluate.scoring.score import SWITCHED_OFF, face_metrics, learned_metrics, score, source_hashes, unavailable
from evaluate.scoring.touched import changed_words, touched_images
from ggavatar.data.capture import Capture
from ggavatar.errors import InputError
from ggavatar.io.atomic import remove_partial_files
from ggavatar.io.folder_lock import lock_folder
from ggavatar.io.held_folders import make_folder
from ggavatar.io.json_files import read_json
from ggavatar.pretrained.resolve import ModelFinder


@runtime_checkable
class Reporter(Interface):
    """What the command shows while it works."""

    def progress(self, title: str) -> Progress | None:
        """A callback with (done, total) for a task with this title."""
        ...

    def warn(self, text: str) -> None:
        """One line that the user should read."""
        ...


@dataclass(frozen=True)
class Job:
    """Images to make and score.

    Attributes:
        home: The evaluation folder.
        protocol: What is measured.
        task: Frames, ground truth and identity of the images.
        capture: Source of the ground truth.
        reader: Drives and cameras, for the regions of the head.
        fill: Makes the images that are missing.
        labels: Names and costs, from the content of `predict.json`.
        title: What `fill` does, for its progress.
    """

    home: Path
    protocol: Protocol
    task: PredictionTask
    capture: Capture
    reader: FrameReader
    fill: Callable[[Progress | None], Filled]
    labels: Callable[[dict[str, Any]], Labels]
    title: str = "rendering"


def evaluate_job(job: Job, options: Options, reporter: Reporter) -> tuple[Evaluation, list[Path]]:
    """Make the images that are missing, score them, or read the scores if nothing has changed since.

    Returns:
        The evaluation and its files.
    """
    make_folder(job.home)
    with lock_folder(job.home):
        remove_partial_files(job.home, *(job.home / name for name in FOLDERS), *(job.home / "regions").glob("*"))
        return _evaluate_locked(job, options, reporter)


def _evaluate_locked(job: Job, options: Options, reporter: Reporter) -> tuple[Evaluation, list[Path]]:
    home, protocol = job.home, job.protocol
    if reason := _stale(job):
        reporter.warn(f"{home}: made again, because {reason} changed since the last evaluation")
    if options.again or reason:
        remove_evaluation(home)
    filled = job.fill(reporter.progress(job.title))
    if filled.changed:
        reporter.warn(f"{home}: {changed_words(filled.changed)} changed after they were written; made again")
    models = ModelFinder(options.models, options.offline)
    learned = None if options.no_learned else learned_metrics(protocol, models)
    faces = None if options.no_learned else face_metrics(protocol, models)
    labels = job.labels(filled.summary)
    for note in labels.notes if labels.setup.origin == "run" else ():
        reporter.warn(f"{labels.subject}, {labels.method}: {note}")
    weights = source_hashes(protocol, learned, faces)
    earlier = _stored(home, reporter)
    if earlier is not None:
        if not (touched := touched_images(earlier, home)):
            absent = set(unavailable(protocol, learned, faces))
            if _is_current(earlier, protocol, labels) and (_absent(earlier), dict(earlier.weights)) == (
                absent,
                weights,
            ):
                if restore_frames(earlier, home):
                    reporter.warn(f"{home / FRAMES_FILE}: changed since it was written; written again")
                return earlier, [home / METRICS_FILE, home / FRAMES_FILE]
        else:
            reporter.warn(f"{home}: scored again, because {', '.join(touched)} changed since they were scored")
    inside = () if protocol.region == "full" else (protocol.region,)
    wanted = (*protocol.regions, *inside)
    written = write_region_masks(job.capture, job.reader, home, job.task.frames, wanted)
    regions = home / "regions" if written else None
    pairs = pair_folders(home / "predictions", home / "ground_truth", home / "masks", regions, job.task.frames)
    evaluation = score(pairs, protocol, labels, learned, faces, options.threads, reporter.progress("scoring"))
    return evaluation, write_results(evaluation, home)


def _stale(job: Job) -> str:
    """What differs between the stored task and this one, in words; empty if nothing does or nothing is stored."""
    path = job.home / SUMMARY
    if not path.is_file():
        return ""
    stored, wanted = _read_tolerantly(path), job.task.described()
    if stored.get("key") == job.task.key():
        return ""
    before = stored.get("identity")
    if not isinstance(before, dict):
        return f"its description ({SUMMARY})"
    changed = [name for name, value in wanted["identity"].items() if before.get(name) != value]
    changed += [name for name, value in wanted.items() if name != "identity" and stored.get(name) != value]
    words = {"capture_sha256": "the capture", "checkpoint_sha256": "the checkpoint", "size": "the image size"}
    return " and ".join(words.get(name, f"the {name.replace('_', ' ')}") for name in changed) or "its description"


def _stored(home: Path, reporter: Reporter) -> Evaluation | None:
    """The stored evaluation; None, with a warning, if it is damaged."""
    if not (home / METRICS_FILE).is_file():
        return None
    try:
        return read_results(home)
    except InputError as error:
        reporter.warn(f"{error}; scored again now")
        return None


def _is_current(found: Evaluation, protocol: Protocol, labels: Labels) -> bool:
    """Whether stored scores have the protocol and the labels of this call."""
    return (found.protocol.digest, found.subject, found.method, found.seed, found.setup) == (
        protocol.digest,
        labels.subject,
        labels.method,
        labels.seed,
        labels.setup,
    ) and set(labels.notes) <= set(found.notes)


def _absent(found: Evaluation) -> set[str]:
    """Metrics that had no weights."""
    return {name for name, reason in found.missing.items() if reason == SWITCHED_OFF or reason.startswith(NO_WEIGHTS)}


def remove_evaluation(home: Path) -> None:
    """Delete the files that an earlier evaluation wrote; anything else in the folder stays."""
    summary = _read_tolerantly(home / SUMMARY) if (home / SUMMARY).is_file() else {}
    names = [f"{number:06d}.png" for number in summary.get("frames", ())]
    folders = [home / name for name in FOLDERS]
    folders += [path for path in (home / "regions").glob("*") if path.is_dir()]
    recorded = [path for path, _ in read_digests(home).values()]
    for path in (*recorded, *(folder / name for folder in folders for name in names)):
        path.unlink(missing_ok=True)
    for path in folders:
        if path.is_dir() and not any(path.iterdir()):
            path.rmdir()
    for name in (METRICS_FILE, FRAMES_FILE, SUMS, SUMMARY):  # the summary last: it says that the folder is ours
        (home / name).unlink(missing_ok=True)


def _read_tolerantly(path: Path) -> dict[str, Any]:
    """A JSON object, empty if the file is damaged; what it described is then made again."""
    try:
        return read_json(path)
    except (InputError, OSError):
        return {}
