"""Performances carried over to the avatar of a run, for the exports of `ggavatar`."""

from __future__ import annotations

from pathlib import Path

from evaluate.motion.retarget import drives_and_cameras
from evaluate.rendering.driven import perform_as_asked
from ggavatar.formats.driving_options import DrivingOptions
from ggavatar.formats.performances import CarriedOver
from ggavatar.pretrained.resolve import ModelFinder
from ggavatar.training.run_folder import Run


def transferred_performance(run: Run, source: Path, options: DrivingOptions) -> CarriedOver:
    """What ggavatar-render --drive would render, with the cameras at the size of the run's capture."""
    performance = perform_as_asked(run, source, options, ModelFinder())
    frames, drives, cameras = zip(*drives_and_cameras(performance.moved, run.head), strict=True)
    size = (run.capture.width, run.capture.height)
    return CarriedOver(
        performance.moved.fps, frames, drives, tuple(camera.resized(*size) for camera in cameras), performance.note
    )
