"""Performances carried over to the head of a run, as clips of its web page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from evaluate.motion.retarget import drives_and_cameras
from evaluate.motion.transfer import TransferOptions
from evaluate.rendering.driven import Rest, perform
from ggavatar.core import Camera, Drive
from ggavatar.pretrained.resolve import ModelFinder
from ggavatar.training.run_folder import Run


def transferred_performance(run: Run, source: Path) -> tuple[float, Sequence[int], Sequence[Drive], Sequence[Camera]]:
    """Frame rate, frame numbers, drives and cameras of a performance, by the defaults of ggavatar-render --drive."""
    moved = perform(run, source, TransferOptions(), Rest(), ModelFinder()).moved
    frames, drives, cameras = zip(*drives_and_cameras(moved, run.head), strict=True)
    return moved.fps, frames, drives, cameras
