"""Simulated tracker errors for the generated person's tracking."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy import ndarray
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from preprocess.formats.tracking_record import TrackingRecord


def add_tracker_errors(record: TrackingRecord, level: float, seed: int) -> TrackingRecord:
    """The record with errors such as trackers make; level 0 returns it unchanged, 1 is typical of monocular trackers.

    Errors vary over a few frames (jitter) and have a constant part (bias): pose 0.2°, 0.5 mm across and 3 mm along the
    view, focal length 1.5 % with the depth that compensates for it, coefficients 0.04, jaw 0.01 rad, gaze 0.03 rad,
    eyelids 0.06.
    """
    if level == 0:
        return record
    generator = np.random.default_rng([seed, 77])
    frames = len(record.numbers)

    def errors(size: float, columns: int) -> ndarray:
        jitter = gaussian_filter1d(generator.standard_normal((frames, columns)), 0.8, axis=0)
        bias = 0.5 * generator.standard_normal(columns)
        return level * size * (1.2 * jitter + bias)

    turn = Rotation.from_rotvec(errors(0.0035, 3)).as_matrix()
    pose = record.world_to_camera.copy()
    pose[:, :3, :3] = turn @ pose[:, :3, :3]
    zoom = 1 + 0.015 * level * generator.uniform(-1, 1)
    pose[:, :3, 3] = pose[:, :3, 3] * (1, 1, zoom) + errors(0.001, 3) * (0.5, 0.5, 3.0)
    intrinsics = record.intrinsics.copy()
    intrinsics[:, [0, 1], [0, 1]] *= zoom
    used = np.ptp(record.expression, axis=0) > 0
    # The order of the draws decides every error: keep it.
    expression = record.expression + errors(0.04, record.expression.shape[1]) * used
    joints = record.joint_rotations.copy()
    joints[:, 2] += errors(0.01, 3) * (1, 0.2, 0.1)
    joints[:, 3:] += errors(0.03, 6).reshape(frames, 2, 3) * (1, 1, 0)
    eyelids = np.clip(record.eyelids + errors(0.06, 2), -0.2, 1.1)
    return dataclasses.replace(
        record,
        expression=expression,
        joint_rotations=joints,
        eyelids=eyelids,
        world_to_camera=pose,
        intrinsics=intrinsics,
    )
