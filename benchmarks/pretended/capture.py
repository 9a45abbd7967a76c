"""A small capture of the generated head in front of noise: counts depend on neither pixels nor size."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ggavatar.data.capture import Capture, Tracking
from ggavatar.data.splits import Split
from ggavatar.head.files import save_head
from ggavatar.head.model import HeadModel
from ggavatar.head.procedural.model import procedural_head

SIZE, FRAMES = 48, 10


def write_capture(folder: Path, size: int = SIZE, frames: int = FRAMES) -> Capture:
    """Write the capture to a folder that does not exist, and open it."""
    head, random = procedural_head(), np.random.default_rng(0)
    numbers = tuple(range(frames))
    described = Capture(
        folder=folder, subject="generated", width=size, height=size, fps=25.0, frames=numbers,
        splits={"every-20th": Split(numbers[1:-1], (numbers[0], numbers[-1]))},
        tracking=_tracking(head, size, frames), head_version=head.version,
    )  # fmt: skip
    mask = np.full((size, size), 255, np.uint8)
    arrays_path = folder.with_suffix(".npz")
    save_head(head, arrays_path)
    with np.load(arrays_path) as arrays:
        stored = {name: arrays[name] for name in arrays.files}
    arrays_path.unlink()
    described.write(((random.integers(0, 256, (size, size, 3), np.uint8), mask) for _ in numbers), stored)
    return Capture.open(folder)


def _tracking(head: HeadModel, size: int, frames: int) -> Tracking:
    """Expressions and a jaw that move, in front of a camera one meter away."""
    time = np.linspace(0, 1, frames)[:, None]
    expression = 0.3 * np.sin(time * np.arange(3, 3 + head.expression_basis.shape[2]))
    joints = np.zeros((frames, len(head.parents), 3))
    joints[:, head.joint_index("jaw"), 0] = 0.1 * (1 + np.sin(7 * time[:, 0]))
    low, high = head.neutral().amin(0).numpy(), head.neutral().amax(0).numpy()
    center, extent = (low + high) / 2, float((high - low).max())
    view = np.diag([1.0, -1.0, -1.0, 1.0])
    view[:3, 3] = -view[:3, :3] @ (center + np.array([0.0, 0.0, 1.0]))
    focal = 0.9 * size / extent
    intrinsics = np.array([[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1]])
    return Tracking(
        intrinsics=np.repeat(intrinsics[None], frames, 0),
        world_to_camera=np.repeat(view[None], frames, 0),
        expression=expression,
        joint_rotations=joints,
        eyelids=0.5 + 0.5 * np.sin(5 * time + np.arange(2)),
        translation=np.zeros((frames, 3)),
    )
