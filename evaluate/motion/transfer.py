"""Cross-identity reenactment: a performance of one head carried over to another, relative to both neutral frames.

Expression coefficients of two people agree in how they change, not in their values: a tracker explains part of a face's
identity by expression. So the change from the driver's neutral frame is added to the target's neutral frame.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from evaluate.motion.driving_sequence import Cameras, DrivingSequence
from evaluate.motion.smoothing import smoothed


@dataclasses.dataclass(frozen=True)
class TransferOptions:
    """How a performance is carried over.

    Attributes:
        expression: `relative` adds changes from neutral to neutral; `absolute` copies coefficients and joints.
        pose: The same for the head's pose in front of the camera; `still` keeps the target's neutral pose.
        smooth: One of `evaluate.motion.smoothing.METHODS`.
        margin: How far beyond the range seen in training a value may go, in widths of that range; None does not limit.
    """

    expression: str = "relative"
    pose: str = "relative"
    smooth: str = "savgol"
    margin: float | None = 0.15


def neutral_row(motion: DrivingSequence) -> int:
    """The frame nearest to a closed-mouth, open-eyed, forward-facing rest.

    The sum of squared expression coefficients in units of their deviation over the clip, of joint angles (root and neck
    too) and of lids is least there; constant coefficients do not count.
    """
    deviation = motion.expression.std(axis=0)
    scaled = motion.expression / np.where(deviation > 1e-9, deviation, np.inf)
    terms = [np.square(scaled).mean(axis=1)] if scaled.shape[1] else []
    terms.append(np.square(np.abs(motion.joint_rotations).sum(axis=(1, 2)) / 0.1))
    terms.append(np.square(motion.eyelids / 0.25).sum(axis=1))
    return int(np.argmin(np.sum(terms, axis=0)))


def transfer_performance(
    driver: DrivingSequence, driver_neutral: int, target: DrivingSequence, target_neutral: int, how: TransferOptions
) -> DrivingSequence:
    """The driver's performance by the target.

    Args:
        driver: Already in the target's basis and joint order (`evaluate.motion.retarget.fitted_to`).
        driver_neutral: Row of the driver's neutral frame.
        target: What the avatar was trained on; its ranges are the limits.
        target_neutral: Row of the target's neutral frame.
        how: Manner of transfer, smoothing and limits.

    Returns:
        DrivingSequence for the target with the driver's frames and speed, seen by the target's camera.
    """
    steady = _steadied(driver, driver_neutral, how.smooth)
    rest, goal = steady.rows(_only(driver_neutral)), target.rows(_only(target_neutral))
    moved = dataclasses.replace(steady, cameras=_cameras(steady, rest.cameras, goal.cameras, how.pose))
    if how.expression == "relative":
        moved = dataclasses.replace(
            moved,
            expression=goal.expression + steady.expression - rest.expression,
            joint_rotations=_joints(steady, rest, goal),
            eyelids=goal.eyelids + steady.eyelids - rest.eyelids,
            translation=goal.translation + steady.translation - rest.translation,
        )
    return moved if how.margin is None else limit_to_seen(moved, target, target_neutral, how.margin)


def _only(row: int) -> slice:
    return slice(row, row + 1)


def _joints(driver: DrivingSequence, rest: DrivingSequence, goal: DrivingSequence) -> Float[np.ndarray, "T J 3"]:
    """Turns from the driver's neutral joints, in the axes of the parent, applied to the target's neutral joints."""
    return np.stack(
        [
            _turned(driver.joint_rotations[:, joint], rest.joint_rotations[0, joint], goal.joint_rotations[0, joint])
            for joint in range(driver.joint_rotations.shape[1])
        ],
        axis=1,
    )


def _turned(rotations: Float[np.ndarray, "T 3"], rest: np.ndarray, goal: np.ndarray) -> Float[np.ndarray, "T 3"]:
    """R · restᵀ · goal, all as axis-angle."""
    turn = Rotation.from_rotvec(rotations) * Rotation.from_rotvec(rest).inv()
    return (turn * Rotation.from_rotvec(goal)).as_rotvec()


def _cameras(steady: DrivingSequence, rest: Cameras | None, goal: Cameras | None, pose: str) -> Cameras | None:
    """The target's camera: turned as the driver's from its neutral frame, and moved by as much of the picture."""
    if goal is None:
        return None
    driver, count = steady.cameras, len(steady.frames)
    still = np.repeat(goal.world_to_camera, count, axis=0)
    intrinsics = np.repeat(goal.intrinsics, count, axis=0)
    if driver is None or rest is None or pose == "still":
        return Cameras(still, intrinsics, goal.size)
    views = driver.world_to_camera if pose == "absolute" else still
    if pose == "relative":
        turn = driver.world_to_camera[:, :3, :3] @ rest.world_to_camera[0, :3, :3].T
        change = driver.world_to_camera[:, :3, 3] - rest.world_to_camera[0, :3, 3]
        views[:, :3, :3] = turn @ goal.world_to_camera[0, :3, :3]
        views[:, :3, 3] += change * (goal.view_width() / rest.view_width())
    return Cameras(views, intrinsics, goal.size)


def _steadied(motion: DrivingSequence, neutral: int, method: str) -> DrivingSequence:
    """The performance filtered; rotations as axis-angle from the neutral frame, where no wrap is near."""
    if method == "none":
        return motion

    def filtered(values: np.ndarray) -> np.ndarray:
        return smoothed(values.reshape(len(values), -1), method, motion.fps).reshape(values.shape)

    def turned(rotations: np.ndarray) -> np.ndarray:
        base = Rotation.from_rotvec(rotations[neutral])
        return (
            Rotation.from_rotvec(filtered((Rotation.from_rotvec(rotations) * base.inv()).as_rotvec())) * base
        ).as_rotvec()

    joints = [turned(motion.joint_rotations[:, joint]) for joint in range(motion.joint_rotations.shape[1])]
    cameras = motion.cameras
    if cameras is not None:
        views = cameras.world_to_camera.copy()
        views[:, :3, :3] = Rotation.from_rotvec(turned(Rotation.from_matrix(views[:, :3, :3]).as_rotvec())).as_matrix()
        views[:, :3, 3] = filtered(views[:, :3, 3])
        cameras = Cameras(views, cameras.intrinsics, cameras.size)
    return dataclasses.replace(
        motion,
        expression=filtered(motion.expression),
        joint_rotations=np.stack(joints, axis=1) if joints else motion.joint_rotations,
        eyelids=filtered(motion.eyelids),
        translation=filtered(motion.translation),
        cameras=cameras,
    )


def limit_to_seen(motion: DrivingSequence, seen: DrivingSequence, neutral: int, margin: float) -> DrivingSequence:
    """The motion kept near what was trained on: untouched in the range seen, bent smoothly towards an end beyond it.

    Args:
        motion: To be limited.
        seen: Frames trained on.
        neutral: Row of `seen` from which joint angles are measured.
        margin: Width of the zone beyond the range, in widths of the range.
    """
    joints = [
        _limited_turn(motion.joint_rotations[:, joint], seen.joint_rotations[:, joint], neutral, margin)
        for joint in range(motion.joint_rotations.shape[1])
    ]
    return dataclasses.replace(
        motion,
        expression=soft_clip(motion.expression, seen.expression, margin),
        joint_rotations=np.stack(joints, axis=1) if joints else motion.joint_rotations,
        eyelids=soft_clip(motion.eyelids, seen.eyelids, margin),
    )


def soft_clip(
    values: Float[np.ndarray, "T D"], seen: Float[np.ndarray, "S D"], margin: float
) -> Float[np.ndarray, "T D"]:
    """Identity within the range of `seen` per column; beyond it a hyperbolic tangent that ends `margin` widths out."""
    low, high = seen.min(axis=0), seen.max(axis=0)
    zone = margin * np.maximum(high - low, np.median(high - low) if values.shape[1] else 0.0) + 1e-9
    inside = np.clip(values, low, high)
    return inside + zone * np.tanh((values - inside) / zone)


def _limited_turn(
    rotations: Float[np.ndarray, "T 3"], seen: Float[np.ndarray, "S 3"], neutral: int, margin: float
) -> Float[np.ndarray, "T 3"]:
    """Rotations whose angle from the neutral one stays near the largest seen."""
    base = Rotation.from_rotvec(seen[neutral])
    turns = (Rotation.from_rotvec(rotations) * base.inv()).as_rotvec()
    angles = np.linalg.norm(turns, axis=1, keepdims=True)
    most = (Rotation.from_rotvec(seen) * base.inv()).magnitude().max()
    kept = soft_clip(angles, np.array([[0.0], [most]]), margin)
    return (Rotation.from_rotvec(turns * (kept / np.maximum(angles, 1e-12))) * base).as_rotvec()
