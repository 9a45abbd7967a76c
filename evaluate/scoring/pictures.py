"""Scores pictures rendered elsewhere under the protocol, ground truth, masks and regions of a run of their capture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch

from evaluate.escaping.file_names import file_stem
from evaluate.options import Options
from evaluate.protocols.protocol import Protocol
from evaluate.protocols.results import Evaluation
from evaluate.protocols.setup import Setup
from evaluate.scoring.accumulator import Labels
from evaluate.scoring.evaluation_job import Job, Reporter, evaluate_job
from evaluate.scoring.frame_files import frame_files
from evaluate.scoring.frame_store import FOLDERS, SUMMARY, Filled, PredictionTask, Progress, fill_frames
from evaluate.scoring.scored_frames import ScoredFrames, choose_frames, for_capture, ground_truth_of
from ggavatar.data.capture import Capture
from ggavatar.data.frames import Frames
from ggavatar.errors import InputError, nearest
from ggavatar.formats.imported_run import DEFAULT_SPLIT
from ggavatar.formats.source_options import is_gaussian_file
from ggavatar.head.files import load_head
from ggavatar.io.atomic import write_atomically
from ggavatar.io.digests import sha256_of
from ggavatar.io.held_folders import make_folder
from ggavatar.io.images import image_header
from ggavatar.io.json_files import write_sealed_json
from ggavatar.io.picture_bytes import MAX_IMAGE_BYTES
from ggavatar.io.regular_files import read_file
from ggavatar.text.names import clean_name
from ggavatar.training.run_folder import RunConfig, find_capture, read_config, read_split

WHITE = (1.0, 1.0, 1.0)
NOTE = "rendered elsewhere; its training frames are not known"


@dataclass(frozen=True)
class Pictures:
    """A folder of pictures and the capture that they show.

    Attributes:
        label: Name in the table.
        folder: Folder of images named by source frame number.
        capture: The capture.
        own: Split and test frames of the run beside which they are scored; None without a run.
        background: Background of that run, sRGB.
    """

    label: str
    folder: Path
    capture: Capture
    own: ScoredFrames | None = None
    background: tuple[float, float, float] = WHITE


def find_pictures(options: Options) -> list[Pictures]:
    """The pictures of --pred and --pred-as with their captures.

    Raises:
        InputError: A folder or a capture cannot be used, or it is not clear which capture the pictures show.
    """
    folders = options.folders
    if folders.pred is not None:
        capture = Capture.open(options.source.capture or Path())
        return [Pictures(folders.method or clean_name(folders.pred.resolve().name), folders.pred, capture)]
    known = _subjects(options)
    found: list[Pictures] = []
    for text in folders.pred_as:
        name, folder = parse_named_folder(text)
        label, at, subject = name.partition("@")
        label, subject = clean_name(label), clean_name(subject)
        if at and subject not in known:
            raise InputError(
                f"--pred-as {text}: no subject {subject!r}{nearest(subject, known)}; known are {', '.join(known)}"
            )
        if not at and len(known) > 1:
            raise InputError(
                f"--pred-as {text}: the runs show {len(known)} subjects ({', '.join(known)}); name the one of these "
                f"pictures, for example {label}@{next(iter(known))}={folder}"
            )
        capture, own, background = known[subject] if at else next(iter(known.values()))
        if any((one.label, one.capture.subject) == (label, capture.subject) for one in found):
            raise InputError(f"--pred-as {text}: {label} of {capture.subject} is named twice; give it another name")
        found.append(Pictures(label, folder, capture, own, background))
    return found


def parse_named_folder(text: str) -> tuple[str, Path]:
    """Name and folder of `NAME=DIR`; `InputError` for any other text."""
    name, equals, folder = text.partition("=")
    if not (name and equals and folder):
        raise InputError(f"--pred-as: expected NAME=DIR, such as mine=renders, found {text!r}")
    return name, Path(folder)


Known = tuple[Capture, ScoredFrames | None, tuple[float, float, float]]


def _subjects(options: Options) -> dict[str, Known]:
    """Captures by subject, with the test frames of the first run of each."""
    moved = options.source.capture
    found: dict[str, Known] = {}
    for path in options.runs:
        if is_gaussian_file(path) or not (path / "config.json").is_file():
            continue
        config = read_config(path)
        capture = Capture.open(moved or find_capture(path, config))
        found.setdefault(capture.subject, (capture, ScoredFrames(config.split, read_split(path).test), _color(config)))
    if not found and moved is not None:
        capture = Capture.open(moved)
        found[capture.subject] = (capture, None, WHITE)
    if not found:
        raise InputError(
            "--pred-as: expected the capture of the pictures, found none (metrics.json does not say where it is); add "
            "a run folder, or --capture DIR"
        )
    return found


def _color(config: RunConfig) -> tuple[float, float, float]:
    red, green, blue = config.background
    return red, green, blue


def evaluate_pictures(pictures: Pictures, options: Options, reporter: Reporter) -> tuple[Evaluation, list[Path]]:
    """Score pictures as a run of their capture would be scored.

    Returns:
        The evaluation and its files, in `evaluation_folder`.

    Raises:
        InputError: Frames are missing, or an image has another size than the ground truth.
    """
    capture = pictures.capture
    split = pictures.own.split if pictures.own else DEFAULT_SPLIT
    protocol = for_capture(options.base_protocol(split), capture)
    chosen = choose_frames(capture, protocol, options.split_rule, pictures.own)
    files = require_pictures(pictures.folder, chosen.frames, protocol.size or (capture.width, capture.height))
    label, subject = pictures.label, options.folders.subject or capture.subject
    digests = {number: sha256_of(path) for number, path in files.items()}
    measured = capture.digest()
    task = PredictionTask(
        chosen.frames,
        ground_truth_of(protocol, pictures.background),
        {"subject": subject, "capture_sha256": measured, "split": chosen.split, "fps": capture.fps},
    )
    home = evaluation_folder(pictures, options, protocol)
    provenance = {"predictions": str(pictures.folder), "capture": str(capture.folder), "capture_sha256": measured}
    labels = Labels(subject, label, options.folders.seed, {}, provenance, (NOTE,), Setup("elsewhere"))
    head = load_head(capture.head_path)
    job = Job(
        home=home,
        protocol=protocol,
        task=task,
        capture=capture,
        reader=Frames(capture, head, torch.tensor(pictures.background), "cpu"),
        fill=lambda progress: _copy_pictures(home, task, capture, (files, digests), progress),
        labels=lambda summary: labels,
        title="copying",
    )
    return evaluate_job(job, options, reporter)


def evaluation_folder(pictures: Pictures, options: Options, protocol: Protocol) -> Path:
    """Where the evaluation of pictures is written: beside their folder, or below -o, never into their folder itself."""
    if options.output is None:
        own = pictures.folder.resolve()
        return own.with_name(f"{own.name}-evaluation") / "eval" / protocol.id
    if options.folders.pred is not None:
        return options.output / "eval" / protocol.id
    name = file_stem(f"{pictures.capture.subject}-{pictures.label}")
    return options.output / "pictures" / name / "eval" / protocol.id


def require_pictures(folder: Path, frames: Sequence[int], size: tuple[int, int]) -> dict[int, Path]:
    """The pictures of these frames, paired by the number in their names.

    Raises:
        InputError: The folder lacks frames, or a picture has another size.
    """
    files = frame_files(folder)
    missing = [number for number in frames if number not in files]
    if missing:
        names = ", ".join(f"{number:06d}.png" for number in missing[:5]) + (", …" if len(missing) > 5 else "")
        counted = list(files) in ([*range(len(frames))], [*range(1, len(frames) + 1)])
        hint = (
            f"; the names count from {min(files)} to {max(files)}, but pictures are paired by source frame number, "
            "never by position: rename them"
            if counted
            else "; render them, or name them by source frame number"
        )
        raise InputError(f"{folder}: {len(missing)} of {len(frames)} test frames are missing: {names}{hint}")
    for number in frames:
        header = image_header(files[number])
        if (header.width, header.height) != size:
            raise InputError(
                f"{files[number]}: expected {size[0]}×{size[1]} px, the size of the ground truth, found "
                f"{header.width}×{header.height} px; render at that size (nothing is resized silently), or score at "
                "another with --resolution WIDTHxHEIGHT"
            )
    return {number: files[number] for number in frames}


def _copy_pictures(
    home: Path,
    task: PredictionTask,
    capture: Capture,
    pictures: tuple[dict[int, Path], dict[int, str]],
    progress: Progress | None,
) -> Filled:
    """Copy the pictures byte by byte beside ground truth and masks; only those that are not there yet.

    Args:
        home: The evaluation folder.
        task: Frames and ground truth.
        capture: Source of the ground truth.
        pictures: Files by frame, and their SHA-256.
        progress: Called with (done, total).
    """
    files, digests = pictures

    def copy(number: int, size: tuple[int, int]) -> Path:
        target = home / FOLDERS[0] / f"{number:06d}{files[number].suffix.lower()}"
        make_folder(target.parent)
        for old in target.parent.glob(f"{number:06d}.*"):
            old.unlink()
        content = read_file(files[number], MAX_IMAGE_BYTES, "an image")
        write_atomically(target, lambda stream: stream.write(content), durable=False)
        return target

    filled = fill_frames(home, task, capture, copy, digests, progress)
    if not filled.summary["complete"]:
        write_sealed_json(home / SUMMARY, {**filled.summary, "complete": True})
    return filled
