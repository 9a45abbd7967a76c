"""Performances carried over to the head of a run: for ggavatar-render --drive, and for clips of web pages."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from evaluate.motion.driving_sequence import DrivingSequence, driving_sequence_of, read_driving_sequence
from evaluate.motion.retarget import drives_and_cameras, match_basis
from evaluate.motion.transfer import TransferOptions, neutral_row, transfer_performance
from ggavatar.core import Camera, Drive
from ggavatar.errors import InputError
from ggavatar.head.files import load_head
from ggavatar.training.run_folder import Run


@dataclass(frozen=True)
class NeutralFrames:
    """Frame numbers of the neutral frames; None is detected.

    Attributes:
        driver: Of the driving sequence.
        target: Of the run's capture.
    """

    driver: int | None = None
    target: int | None = None


def carried_over(
    run: Run, source: Path, how: TransferOptions, neutral: NeutralFrames, force_basis: bool
) -> tuple[DrivingSequence, DrivingSequence]:
    """The driving sequence in the basis of a run's head, and the sequence that it becomes for this head.

    Raises:
        InputError: The source is no driving sequence, does not fit the head, or lacks cameras that are asked for.
    """
    target = driving_sequence_of(run.capture)
    driver = match_basis(read_driving_sequence(source), target, force_basis)
    if how.expression == "absolute" and how.pose == "absolute" and driver.cameras is None:
        raise InputError(f"{source}: expected cameras for --pose absolute, found none; use --pose still")
    seen = target.rows(np.array([target.row(frame) for frame in run.split.train]))
    rows = row_of_neutral(driver, neutral.driver), row_of_neutral(seen, neutral.target)
    return driver, transfer_performance(driver, rows[0], seen, rows[1], how)


def row_of_neutral(sequence: DrivingSequence, frame: int | None) -> int:
    """Row of a frame, or of the one that is closest to neutral."""
    return neutral_row(sequence) if frame is None else sequence.row(frame)


def transferred_performance(run: Run, source: Path) -> tuple[float, Sequence[int], Sequence[Drive], Sequence[Camera]]:
    """Frame rate, frame numbers, drives and cameras of a performance, by the defaults of ggavatar-render --drive."""
    _, moved = carried_over(run, source, TransferOptions(), NeutralFrames(), force_basis=False)
    head = load_head(run.capture.head_path).to(run.background.device, torch.float32)
    frames, drives, cameras = zip(*drives_and_cameras(moved, head), strict=True)
    return moved.fps, frames, drives, cameras
