"""The ordered stages from video to capture, and the folder they work in."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from ggavatar.data.capture import DESCRIPTION
from ggavatar.errors import InputError
from preprocess.options import PrepOptions
from preprocess.pipeline import crop_stage, doctor_stage, mask_stage, pack_stage, read_stage, tracking_stage
from preprocess.pipeline.stage import (
    RECORDS,
    Reporter,
    Stage,
    StageContext,
    fingerprint,
    finished_result,
    was_interrupted,
    write_record,
)

STAGES = (
    read_stage.STAGE,
    crop_stage.STAGE,
    mask_stage.STAGE,
    tracking_stage.STAGE,
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

    Args:
        options: What to do.
        reporter: Called with each stage and whether it is skipped; gives the place to report to while the stage runs.
        stages: The stages, in order.

    Returns:
        The results of all stages, by name.

    Raises:
        InputError: Bad input, or a folder that must not be written to.
    """
    wanted = _fingerprints(options, stages)
    prepare_folder(options)
    results: dict[str, Mapping[str, Any]] = {}
    for stage, before in zip(stages, wanted, strict=True):
        result = finished_result(options.output_dir, stage, before)
        with reporter(stage, result is not None) as place:
            results[stage.name] = (
                result
                if result is not None
                else _run(stage, StageContext(options, options.output_dir, results, place), before)
            )
    return results


def _fingerprints(options: PrepOptions, stages: tuple[Stage, ...]) -> list[str]:
    """Fingerprints of all stages; taken before anything is written, since this is where missing inputs show."""
    found: list[str] = []
    for stage in stages:
        found.append(fingerprint(stage, options, found[-1] if found else ""))
    return found


def _run(stage: Stage, context: StageContext, wanted: str) -> Mapping[str, Any]:
    """Run one stage. From here until the end of packing the folder is no capture.

    So nobody reads half of a new and half of an old one.
    """
    if stage.name != doctor_stage.STAGE.name:
        (context.folder / DESCRIPTION).unlink(missing_ok=True)
    if not was_interrupted(context.folder, stage, wanted):
        for name in stage.outputs:
            _remove_output(context.folder / name)
    write_record(context.folder, stage, wanted, None)
    result = stage.run(context)
    write_record(context.folder, stage, wanted, result)
    return result


def _remove_output(path: Path) -> None:
    """Remove what an earlier run of a stage wrote: the file, or the numbered pictures in the folder."""
    if path.is_dir():
        for picture in path.glob("[0-9]*.png"):
            picture.unlink()
    else:
        path.unlink(missing_ok=True)


def prepare_folder(options: PrepOptions) -> None:
    """Make the output folder, or make sure that we may write into the one that is there.

    A folder is only ever emptied if it carries our records; a folder of the user's is never touched.
    """
    folder = options.output_dir
    if options.resume and options.overwrite:
        raise InputError("--resume and --overwrite exclude each other: continue, or start anew?")
    _check_apart(options)
    if folder.exists():
        ours = (folder / RECORDS).is_dir()
        if not folder.is_dir():
            raise InputError(f"{folder}: exists and is not a folder; choose another one with -o")
        if any(folder.iterdir()) and not ours:
            raise InputError(f"{folder}: exists and was not made by ggavatar-prep; choose another folder with -o")
        if ours and not (options.resume or options.overwrite) and any(e.name != RECORDS for e in folder.iterdir()):
            raise InputError(
                f"{folder}: exists; use --resume to continue or reuse it, --overwrite to start anew, or choose "
                "another -o"
            )
        if ours and options.overwrite:
            shutil.rmtree(folder)
    (folder / RECORDS).mkdir(parents=True, exist_ok=True)


def _check_apart(options: PrepOptions) -> None:
    """The output must not contain what is read, or --overwrite would delete it."""
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
