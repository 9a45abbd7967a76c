"""Writes a demo folder: performance, rendering, encoding, tracking."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy import ndarray

from ggavatar.head.files import save_head
from ggavatar.head.procedural.model import procedural_names
from ggavatar.io.atomic import write_atomically, write_text
from ggavatar.jit.threads import run
from preprocess.formats.importers.metrical_tracker import frame_dictionary
from preprocess.formats.tracking_record import FLAME_JOINTS, TrackingRecord
from preprocess.synthetic.animation.performance import FPS, Performance, perform
from preprocess.synthetic.output_folder import DemoFolder, write_manifest
from preprocess.synthetic.rendering import room
from preprocess.synthetic.settings import DemoSettings
from preprocess.synthetic.studio import Studio
from preprocess.synthetic.tracker_errors import add_tracker_errors

_BATCH = 8


def write_demo(folder: Path, settings: DemoSettings) -> Iterator[int]:
    """Write a demo folder; yields every frame number once its files are written."""
    names, _ = procedural_names()
    performance = perform(names, settings.frames, settings.seed * 5 + settings.identity)
    studio = Studio(settings.identity, performance, settings.size, settings.background)
    truth = true_record(performance, settings.size, studio.identity)
    tracked = add_tracker_errors(truth, settings.noise, settings.seed)
    write_manifest(folder, asdict(settings), settings.frames, complete=False)  # first: says what is ours here
    with DemoFolder(folder, settings.size, FPS) as output:
        save_head(studio.head, folder / "head.npz")
        _write_truth(folder / "truth.npz", truth, names)
        write_text(folder / "README.txt", _readme(settings))
        for first in range(0, settings.frames, _BATCH):
            numbers = range(first, min(first + _BATCH, settings.frames))
            for index, (image, alpha) in zip(numbers, _rendered(studio, numbers), strict=True):
                output.add(index, image, alpha)
                _write_frame(output.tracking(index), frame_dictionary(tracked, index) | {"global_step": index})
                yield index
    write_manifest(folder, asdict(settings), settings.frames, complete=True)


def _write_frame(path: Path, content: Mapping[str, Any]) -> None:
    """Write a file of metrical-tracker, atomically."""
    write_atomically(path, lambda stream: torch.save(content, stream), durable=False)


def _rendered(studio: Studio, numbers: range) -> list[tuple[ndarray, ndarray]]:
    """Image and coverage of some frames, rendered by several threads."""
    found: dict[int, tuple[ndarray, ndarray]] = {}

    def render(position: int) -> None:
        found[position] = studio.render(numbers[position])

    run(render, len(numbers))
    return [found[position] for position in range(len(numbers))]


def true_record(performance: Performance, size: int, identity: ndarray) -> TrackingRecord:
    """The performance as an error-free tracker would record it: the head is still and the camera moves."""
    frames = len(performance.jaw)
    joints = np.zeros((frames, FLAME_JOINTS, 3))
    joints[:, 2], joints[:, 3:] = performance.jaw, performance.eyes
    return TrackingRecord(
        numbers=np.arange(frames),
        width=size,
        height=size,
        intrinsics=np.tile(room.intrinsics(size), (frames, 1, 1)),
        world_to_camera=room.room_to_camera() @ performance.head_to_room,
        expression=performance.expression,
        joint_rotations=joints,
        eyelids=performance.eyelids,
        translation=np.zeros((frames, 3)),
        shape=identity,
        version=None,
    )


def _write_truth(path: Path, truth: TrackingRecord, names: tuple[str, ...]) -> None:
    """Write the true parameters, for tests of trackers."""
    arrays = dict(
        fps=np.asarray(float(FPS)),
        intrinsics=truth.intrinsics,
        world_to_camera=truth.world_to_camera,
        expression=truth.expression,
        expression_names=np.asarray(names),
        joint_rotations=truth.joint_rotations,
        eyelids=truth.eyelids,
        translation=truth.translation,
        shape=np.asarray(truth.shape),
    )
    write_atomically(path, lambda stream: np.savez_compressed(stream, allow_pickle=False, **arrays))


def _readme(settings: DemoSettings) -> str:
    return (
        f"GGAvatar generated person {settings.identity}.\n"
        "No photograph, scan or licensed model was used.\n"
        f"{settings.frames} frames at {FPS} fps, {settings.size} px, background {settings.background}, "
        f"tracker noise {settings.noise:g}, "
        f"seed {settings.seed}.\n\n"
        "video.mp4          H.264\n"
        "masks/00000.png    true coverage of the person, 8 bit\n"
        "tracking/00000.frame  metrical-tracker's layout; frame k belongs to image k;\n"
        "                   the first coefficients of exp are those of head.npz\n"
        "head.npz           the head model that the tracking belongs to (docs/capture-format.md)\n"
        "truth.npz          poses, focal length and parameters without tracker noise\n"
    )
