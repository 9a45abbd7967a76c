"""The performance of somebody else as an avatar performs it: read, measured and carried over."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from evaluate.motion.driving_sequence import DrivingSequence, driving_sequence_of_run, read_driving_sequence
from evaluate.motion.neutral import neutral_row
from evaluate.motion.retarget import in_version_of, match_basis
from evaluate.motion.transfer import TransferOptions, match_performance, transfer_performance
from ggavatar.data.capture import Capture
from ggavatar.data.expression_scores import measured_scores
from ggavatar.errors import InputError
from ggavatar.formats.driving_options import DrivingOptions
from ggavatar.pretrained.resolve import ModelFinder
from ggavatar.training.run_folder import Run

UNMEASURED = (
    "the faces of driver and avatar were not both measured (the landmark network is not here, no face was found, or "
    "the driver is a file of parameters): only expression axes that both heads have are carried over"
)


@dataclass(frozen=True)
class Performance:
    """A driving sequence, and the one that the avatar performs for it.

    Attributes:
        driver: As read, with expression scores where they could be measured.
        moved: In the avatar's codes, seen by its camera; one row for each of the driver's.
        note: What could not be carried over as asked, in words; empty if all was.
    """

    driver: DrivingSequence
    moved: DrivingSequence
    note: str = ""


@dataclass(frozen=True)
class Rest:
    """Frame numbers that show driver and avatar at rest; None finds them."""

    driver: int | None = None
    target: int | None = None


def perform_as_asked(run: Run, source: Path, options: DrivingOptions, finder: ModelFinder) -> Performance:
    """`perform` by the flags of a command."""
    limit = None if options.limit < 0 else options.limit
    how = TransferOptions(options.transfer, options.pose, options.smooth, limit)
    return perform(run, source, how, Rest(options.driver_neutral, options.target_neutral), finder, options.force_basis)


def perform(
    run: Run, source: Path, how: TransferOptions, rest: Rest, finder: ModelFinder, force: bool = False
) -> Performance:
    """Have the avatar of a run perform what a source shows.

    Args:
        run: The avatar.
        source: Whatever `read_driving_sequence` reads.
        how: Transfer, smoothing and limits.
        rest: Frames at rest.
        finder: Finds the landmark networks.
        force: As in `match_basis`; a transfer by what the faces show needs no common basis.

    Raises:
        InputError: The source cannot be read, or does not fit the avatar.
    """
    target = driving_sequence_of_run(run)
    driver = in_version_of(read_driving_sequence(source), target)
    if how.expression == "absolute" and how.pose == "absolute" and driver.cameras is None:
        raise InputError(f"{source}: expected cameras for --pose absolute, found none; use --pose still")
    rows = None if rest.driver is None else driver.row(rest.driver)
    seen = target.rows(np.array([target.row(frame) for frame in run.split.train]))
    goal = None if rest.target is None else seen.row(rest.target)
    if how.expression == "matched":
        if source.is_dir():
            driver = _measured(driver, Capture.open(source), finder)
        if driver.scores is not None:
            seen = _measured(seen, run.capture, finder)
        note = "" if driver.scores is not None and seen.scores is not None else UNMEASURED
        return Performance(driver, match_performance(driver, rows, seen, goal, how), note)
    fitted = match_basis(driver, target, force)
    rows, goal = _neutral(fitted, rows), _neutral(seen, goal)
    return Performance(driver, transfer_performance(fitted, rows, seen, goal, how))


def _measured(sequence: DrivingSequence, capture: Capture, finder: ModelFinder) -> DrivingSequence:
    """The sequence of a capture with the scores of its frames, if they can be had."""
    return dataclasses.replace(sequence, scores=measured_scores(capture, sequence.frames, finder))


def _neutral(sequence: DrivingSequence, row: int | None) -> int:
    return neutral_row(sequence) if row is None else row
