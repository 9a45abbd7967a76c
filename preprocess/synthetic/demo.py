"""From settings to a demo folder: perform, draw, encode, track."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy import ndarray

from ggavatar.head.files import save_head
from ggavatar.head.procedural.model import procedural_names
from ggavatar.jit.threads import run
from preprocess.synthetic.animation.motion import FPS, Performance, perform
from preprocess.synthetic.output_folder import DemoFolder, write_manifest
from preprocess.synthetic.rendering import room
from preprocess.synthetic.studio import Studio
from preprocess.synthetic.tracker_files import Tracking, disturbed, frame_record, write_frame

_BATCH = 8


@dataclass(frozen=True)
class Settings:
    """What to write; see the options of `ggavatar-demo`."""

    identity: int = 1
    frames: int = 600
    size: int = 512
    noise: float = 0.0
    background: str = "plain"
    seed: int = 0


def write_demo(folder: Path, settings: Settings) -> Iterator[int]:
    """Write a demo folder; yields every frame number once it is on disk."""
    names, _ = procedural_names()
    motion = perform(names, settings.frames, settings.seed * 5 + settings.identity)
    studio = Studio(settings.identity, motion, settings.size, settings.background)
    truth = true_tracking(motion, settings.size, studio.identity)
    tracked = disturbed(truth, settings.noise, settings.seed)
    with DemoFolder(folder, settings.size, FPS) as output:
        write_manifest(folder, asdict(settings), settings.frames)
        save_head(studio.head, folder / "head.npz")
        _write_truth(folder / "truth.npz", truth, names)
        (folder / "README.txt").write_text(_readme(settings), encoding="utf-8")
        for first in range(0, settings.frames, _BATCH):
            numbers = range(first, min(first + _BATCH, settings.frames))
            pictures: dict[int, tuple[ndarray, ndarray]] = {}

            def draw(place: int, numbers: range = numbers, pictures: dict = pictures) -> None:
                pictures[numbers[place]] = studio.draw(numbers[place])

            run(draw, len(numbers))
            for index in numbers:
                output.add(index, *pictures[index])
                write_frame(frame_record(tracked, index, (settings.size, settings.size)), output.tracking(index))
                yield index


def true_tracking(motion: Performance, size: int, identity: ndarray) -> Tracking:
    """The performance in a tracker's words, without errors: the head stands still and the camera moves."""
    return Tracking(
        expression=motion.expression,
        jaw=motion.jaw,
        eyes=motion.eyes,
        eyelids=motion.eyelids,
        world_to_camera=room.room_to_camera() @ motion.head_to_room,
        intrinsics=room.intrinsics(size),
        shape=identity,
    )


def _write_truth(path: Path, truth: Tracking, names: tuple[str, ...]) -> None:
    """True parameters, for tests of trackers."""
    frames = len(truth.jaw)
    rotations = np.zeros((frames, 5, 3))
    rotations[:, 2], rotations[:, 3:] = truth.jaw, truth.eyes
    np.savez_compressed(
        path,
        allow_pickle=False,
        fps=np.asarray(float(FPS)),
        intrinsics=np.tile(truth.intrinsics, (frames, 1, 1)),
        world_to_camera=truth.world_to_camera,
        expression=truth.expression,
        expression_names=np.asarray(names),
        joint_rotations=rotations,
        eyelids=truth.eyelids,
        translation=np.zeros((frames, 3)),
        shape=truth.shape,
    )


def _readme(settings: Settings) -> str:
    return (
        f"GGAvatar embedded subject {settings.identity}: a procedurally generated person.\n"
        "No photograph, scan or licensed model was used.\n"
        f"{settings.frames} frames at {FPS} fps, {settings.size} px, background {settings.background}, "
        f"tracker noise {settings.noise:g}, "
        f"seed {settings.seed}.\n\n"
        "video.mp4          H.264\n"
        "masks/00000.png    true coverage of the person, 8 bit\n"
        "tracking/00000.frame  metrical-tracker's layout; frame k belongs to image k;\n"
        "                   the first coefficients of exp are those of head.npz\n"
        "head.npz           the head model the tracking belongs to (docs/capture-format.md)\n"
        "truth.npz          poses, focal length and parameters without tracker noise\n"
    )
