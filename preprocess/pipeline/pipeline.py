"""The ordered stages from video to capture, and the folder they work in."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from ggavatar.data.capture import DESCRIPTION
from ggavatar.errors import InputError
from ggavatar.io.atomic import remove_partial_files
from ggavatar.io.folder_lock import is_lock_file, lock_folder
from ggavatar.io.held_folders import make_folder
from preprocess.formats.registry import read_tracking_record
from preprocess.options import PrepOptions
from preprocess.pipeline import (
    crop_stage,
    doctor_stage,
    evidence_stage,
    face_stage,
    mask_stage,
    pack_stage,
    read_stage,
    refine_stage,
    tracking_stage,
)
from preprocess.pipeline.stage import (
    RECORDS,
    RecordingReporter,
    Reporter,
    Stage,
    StageContext,
    fingerprint,
    finished_result,
    forget_stages,
    may_begin,
    repeat_messages,
    was_interrupted,
    write_record,
)

STAGES = (
    read_stage.STAGE,
    crop_stage.STAGE,
    face_stage.STAGE,
    evidence_stage.STAGE,
    mask_stage.STAGE,
    tracking_stage.STAGE,
    refine_stage.STAGE,
    pack_stage.STAGE,
    doctor_stage.STAGE,
)

Results = Mapping[str, Mapping[str, Any]]


def run_pipeline(
    options: PrepOptions,
    reporter: Callable[[Stage, bool], AbstractContextManager[Reporter]],
    stages: tuple[Stage, ...] = STAGES,
) -> Results:
    """Run every stage whose inputs have changed since it last ran in this folder.

    The warnings and notes of the others are reported again.

    Args:
        options: The user's options.
        reporter: Called with each stage and whether it is skipped; gives the stage's reporter as a context manager.
        stages: The stages in order.

    Returns:
        The results of all stages by name.

    Raises:
        InputError: Unusable input, or an output folder that must not be written to.
    """
    fingerprints = _fingerprints(options, stages)
    check_folder(options, stages[0], fingerprints[0])
    make_folder(options.output_dir)
    with lock_folder(options.output_dir):
        check_folder(options, stages[0], fingerprints[0])  # again: another process may have had the lock until now
        _begin(options, stages)
        return _run_stages(options, reporter, stages, fingerprints)


def _run_stages(
    options: PrepOptions,
    reporter: Callable[[Stage, bool], AbstractContextManager[Reporter]],
    stages: tuple[Stage, ...],
    fingerprints: Sequence[str],
) -> Results:
    results: dict[str, Mapping[str, Any]] = {}
    record = functools.cache(lambda: read_tracking_record(options))
    for stage, fingerprint_ in zip(stages, fingerprints, strict=True):
        result = finished_result(options.output_dir, stage, fingerprint_)
        with reporter(stage, result is not None) as stage_reporter:
            if result is None:
                recording = RecordingReporter(stage_reporter)
                context = StageContext(options, options.output_dir, results, recording, record)
                result = _run(stage, context, fingerprint_, recording)
            else:
                repeat_messages(options.output_dir, stage, stage_reporter)
            results[stage.name] = result
    return results


def _fingerprints(options: PrepOptions, stages: tuple[Stage, ...]) -> list[str]:
    """Fingerprints of all stages; computed before anything is written, since missing inputs raise here."""
    found: list[str] = []
    for stage in stages:
        found.append(fingerprint(stage, options, found[-1] if found else ""))
    return found


def _run(stage: Stage, context: StageContext, wanted: str, recording: RecordingReporter) -> Mapping[str, Any]:
    """Run one stage.

    capture.json is removed first: until packing has finished the folder is no capture, so that nobody reads a mixture
    of old and new files. Reading the video changes nothing, so that an earlier capture outlives a video that is none.
    """
    if stage.name not in (read_stage.STAGE.name, doctor_stage.STAGE.name):
        (context.folder / DESCRIPTION).unlink(missing_ok=True)
        pack_stage.restore_dropped(context.folder)
    if not was_interrupted(context.folder, stage, wanted):
        for name in stage.outputs:
            _remove_output(context.folder / name)
    write_record(context.folder, stage, wanted, None)
    result = stage.run(context)
    write_record(context.folder, stage, wanted, result, recording.messages)
    return result


def _remove_output(path: Path) -> None:
    """Remove an earlier output of a stage: the file, or the numbered images in the folder."""
    if path.is_dir():
        for image in path.glob("[0-9]*.png"):
            image.unlink()
    else:
        path.unlink(missing_ok=True)


def check_folder(options: PrepOptions, first: Stage, wanted: str) -> None:
    """Check that the output folder may be written to; nothing is changed.

    A folder that a start of this command has left without a capture is continued, unless it began with another input.

    Args:
        options: The user's options.
        first: The first stage.
        wanted: Its fingerprint.

    Raises:
        InputError: The folder must not be written to, or contains an input, or --resume finds nothing to continue.
    """
    folder = options.output_dir
    if options.resume and options.overwrite:
        raise InputError("--resume and --overwrite are mutually exclusive; give one of them")
    _check_apart(options)
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: exists and is not a folder; choose another one with -o")
    entries = list(folder.iterdir()) if folder.exists() else []
    if options.resume and not entries:
        raise InputError(
            f"{folder}: --resume found no capture to continue here; check -o, or omit --resume to start one"
        )
    if not (folder / RECORDS).is_dir() and not all(map(is_lock_file, entries)):
        raise InputError(f"{folder}: exists and was not made by ggavatar-prep; choose another folder with -o")
    if options.resume or options.overwrite:
        return
    if (folder / DESCRIPTION).exists() or not may_begin(folder, first, wanted):
        raise InputError(
            f"{folder}: exists already; pass --resume to continue in it, --overwrite to replace it, or choose another "
            "folder with -o"
        )


def _begin(options: PrepOptions, stages: tuple[Stage, ...]) -> None:
    """Prepare the locked output folder; with --overwrite, every stage replaces what it wrote, and nothing else."""
    records = options.output_dir / RECORDS
    make_folder(records)
    if options.overwrite:
        forget_stages(options.output_dir, stages)
    remove_partial_files(options.output_dir, records, *(options.output_dir / name for name in ("images", "masks")))


def _check_apart(options: PrepOptions) -> None:
    """Check that the output folder contains no input, which --overwrite would delete."""
    target = options.output_dir.resolve()
    sources = [
        options.input,
        options.tracking,
        options.head_model,
        Path(options.masks) if Path(options.masks).exists() else None,
    ]
    for source in sources:
        if source is not None and source.resolve().is_relative_to(target):
            raise InputError(
                f"{source} lies inside the output folder {options.output_dir}; choose another folder with -o"
            )
