"""The embedded subject's tracking, as metrical-tracker would have written it.

One `.frame` per image, with its errors if wanted.

Layout and conversions: metrical-tracker's `.frame` is a `torch.save`d dict of numpy arrays with a batch axis; the head
pose is in the camera, the neck is the identity, rotations are the first two rows of the matrix, `img_size` is [height,
width].
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

EXPRESSIONS, SHAPES = 100, 300


@dataclass(frozen=True)
class Tracking:
    """What a tracker says about T frames.

    Shapes and units as in docs/capture-format.md, without its neck and root joints.
    """

    expression: Float[ndarray, "T E"]
    jaw: Float[ndarray, "T 3"]
    eyes: Float[ndarray, "T 2 3"]
    eyelids: Float[ndarray, "T 2"]
    world_to_camera: Float[ndarray, "T 4 4"]
    intrinsics: Float[ndarray, "3 3"]
    shape: Float[ndarray, " S"]


def disturbed(tracking: Tracking, level: float, seed: int) -> Tracking:
    """The tracking with a tracker's errors; 0 gives it back unchanged, 1 is what monocular trackers do on real clips.

    Errors drift over a few frames (jitter) and are partly constant (bias): pose 0.2°, 0.5 mm across and 3 mm along the
    view, focal length 1.5 % with the depth that compensates for it, coefficients 0.04, jaw 0.01 rad, gaze 0.03 rad,
    lids 0.06.
    """
    if level == 0:
        return tracking
    generator = np.random.default_rng([seed, 77])
    frames = len(tracking.jaw)

    def errors(size: float, columns: int) -> ndarray:
        fast = gaussian_filter1d(generator.standard_normal((frames, columns)), 0.8, axis=0)
        bias = 0.5 * generator.standard_normal(columns)
        return level * size * (1.2 * fast + bias)

    turn = Rotation.from_rotvec(errors(0.0035, 3)).as_matrix()
    pose = tracking.world_to_camera.copy()
    pose[:, :3, :3] = turn @ pose[:, :3, :3]
    zoom = 1 + 0.015 * level * generator.uniform(-1, 1)
    pose[:, :3, 3] = pose[:, :3, 3] * (1, 1, zoom) + errors(0.001, 3) * (0.5, 0.5, 3.0)
    intrinsics = tracking.intrinsics.copy()
    intrinsics[[0, 1], [0, 1]] *= zoom
    shown = np.ptp(tracking.expression, axis=0) > 0
    return replace(
        tracking,
        expression=tracking.expression + errors(0.04, tracking.expression.shape[1]) * shown,
        jaw=tracking.jaw + errors(0.01, 3) * (1, 0.2, 0.1),
        eyes=tracking.eyes + errors(0.03, 6).reshape(frames, 2, 3) * (1, 1, 0),
        eyelids=np.clip(tracking.eyelids + errors(0.06, 2), -0.2, 1.1),
        world_to_camera=pose,
        intrinsics=intrinsics,
    )


def frame_record(tracking: Tracking, index: int, size: tuple[int, int]) -> dict:
    """The content of one `.frame` file.

    Args:
        tracking: All frames.
        index: Which one.
        size: Height and width of the image, px.
    """
    height, width = size
    pose, intrinsics = tracking.world_to_camera[index], tracking.intrinsics
    rotation = pose[:3, :3].T * (-1, -1, 1)
    half = min(height, width) / 2
    focal = intrinsics[0, 0] / half
    principal = ((width / 2 - intrinsics[0, 2]) / half, (height / 2 - intrinsics[1, 2]) / half)
    return {
        "flame": {
            "exp": _row(_padded(tracking.expression[index], EXPRESSIONS)),
            "shape": _row(_padded(tracking.shape, SHAPES)),
            "tex": _row(np.zeros(140)),
            "sh": _row(np.zeros((9, 3))),
            "eyes": _row(_rows_6d(tracking.eyes[index])),
            "eyelids": _row(tracking.eyelids[index]),
            "jaw": _row(_rows_6d(tracking.jaw[index][None])),
        },
        "camera": {
            "R": _row(rotation[:2].ravel()),
            "t": _row(pose[:3, 3] * (-1, -1, 1)),
            "fl": _row([focal]),
            "pp": _row(principal),
        },
        "opencv": {"R": _row(pose[:3, :3]), "t": _row(pose[:3, 3]), "K": _row(intrinsics)},
        "img_size": np.asarray([height, width]),
        "frame_id": f"{index:05d}",
        "global_step": index,
    }


def write_frame(record: dict, path: Path) -> None:
    """Save one record as metrical-tracker does."""
    import torch

    torch.save(record, path)


def _row(values: ndarray | list[float] | tuple[float, ...]) -> ndarray:
    return np.asarray(values, np.float32)[None]


def _padded(values: ndarray, length: int) -> ndarray:
    return np.concatenate((values, np.zeros(length - len(values))))


def _rows_6d(axis_angles: ndarray) -> ndarray:
    """First two rows of each rotation, flattened one after another."""
    return Rotation.from_rotvec(axis_angles).as_matrix()[:, :2].ravel()
