"""Cross-identity reenactment: transfer of a driving sequence to another head, relative to both at rest.

What a face shows is carried over by `evaluate.motion.expression_transfer`; what moves the head, neck and torso, as the
change from a frame in which the driver faces the camera, to such a frame of the target.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from evaluate.motion.driving_sequence import Cameras, DrivingSequence
from evaluate.motion.expression_transfer import carry_over
from evaluate.motion.face import face_of
from evaluate.motion.facial_codes import facial_layout, with_facial_codes
from evaluate.motion.neutral import facing_row
from evaluate.motion.retarget import on_head_of
from evaluate.motion.smoothing import interpolated, smoothed


@dataclasses.dataclass(frozen=True)
class TransferOptions:
    """How a driving sequence is transferred.

    Attributes:
        expression: `matched` looks for the target's face that shows what the driver's shows (`carry_over`); `relative`
            adds the driver's changes of coefficients to the target's neutral frame; `absolute` copies coefficients and
            joint rotations.
        pose: The same for the head's pose relative to the camera; `still` keeps the target's neutral pose.
        smooth: One of `evaluate.motion.smoothing.METHODS`.
        margin: How far a value may leave the range seen in training, as a fraction of that range; None for no limit.
    """

    expression: str = "matched"
    pose: str = "relative"
    smooth: str = "savgol"
    margin: float | None = 3.0


def transfer_performance(
    driver: DrivingSequence, driver_neutral: int, target: DrivingSequence, target_neutral: int, how: TransferOptions
) -> DrivingSequence:
    """Transfer the driver's performance to the target.

    Args:
        driver: Sequence in the target's basis and joint order (`evaluate.motion.retarget.match_basis`).
        driver_neutral: Row of the driver's neutral frame.
        target: Sequence that the avatar was trained on; its ranges are the limits.
        target_neutral: Row of the target's neutral frame.
        how: Transfer, smoothing and limits.

    Returns:
        A sequence for the target with the driver's frames and frame rate, seen by the target's camera.
    """
    smooth = _smoothed_sequence(driver, driver_neutral, how.smooth)
    rest, goal = smooth.rows(_only(driver_neutral)), target.rows(_only(target_neutral))
    moved = dataclasses.replace(smooth, cameras=carried_cameras(smooth, rest.cameras, goal.cameras, how.pose))
    if how.expression != "absolute":
        moved = dataclasses.replace(
            moved,
            expression=goal.expression + smooth.expression - rest.expression,
            joint_rotations=_joints(smooth, rest, goal),
            eyelids=goal.eyelids + smooth.eyelids - rest.eyelids,
            translation=goal.translation + smooth.translation - rest.translation,
        )
    return moved if how.margin is None else limit_to_training_range(moved, target, target_neutral, how.margin)


def match_performance(
    driver: DrivingSequence,
    driver_rest: int | None,
    target: DrivingSequence,
    target_rest: int | None,
    how: TransferOptions,
) -> DrivingSequence:
    """Transfer the driver's performance to the target by what the faces show.

    Args:
        driver: Sequence in a basis of its own.
        driver_rest: Row that shows the driver at rest; None computes it.
        target: Sequence that the avatar was trained on.
        target_rest: Row that shows the target at rest; None computes it.
        how: Pose, smoothing and limits.

    Raises:
        InputError: Nothing is common to both faces.
    """
    rows = _row_or_facing(driver, driver_rest), _row_or_facing(target, target_rest)
    smooth = _smoothed_sequence(driver, rows[0], how.smooth)
    codes = carry_over(face_of(smooth, driver_rest), face_of(target, target_rest))
    body = transfer_performance(
        on_head_of(smooth, target), rows[0], target, rows[1], dataclasses.replace(how, smooth="none", margin=None)
    )
    moved = with_facial_codes(body, facial_layout(target), codes)
    return moved if how.margin is None else limit_to_training_range(moved, target, rows[1], how.margin)


def _row_or_facing(sequence: DrivingSequence, row: int | None) -> int:
    return facing_row(sequence) if row is None else row


def _only(row: int) -> slice:
    return slice(row, row + 1)


def _joints(driver: DrivingSequence, rest: DrivingSequence, goal: DrivingSequence) -> Float[np.ndarray, "T J 3"]:
    """Rotations from the driver's neutral joints, in the parent's axes, applied to the target's neutral joints."""
    return np.stack(
        [
            _rotated(driver.joint_rotations[:, joint], rest.joint_rotations[0, joint], goal.joint_rotations[0, joint])
            for joint in range(driver.joint_rotations.shape[1])
        ],
        axis=1,
    )


def _rotated(rotations: Float[np.ndarray, "T 3"], rest: np.ndarray, goal: np.ndarray) -> Float[np.ndarray, "T 3"]:
    """R · restᵀ · goal, all as axis-angle."""
    turn = Rotation.from_rotvec(rotations) * Rotation.from_rotvec(rest).inv()
    return (turn * Rotation.from_rotvec(goal)).as_rotvec()


def carried_cameras(driving: DrivingSequence, rest: Cameras | None, goal: Cameras | None, pose: str) -> Cameras | None:
    """The target's camera, rotated like the driver's and moved by the same fraction of the image width."""
    if goal is None:
        return None
    driver, count = driving.cameras, len(driving.frames)
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


def _smoothed_sequence(sequence: DrivingSequence, neutral: int, method: str) -> DrivingSequence:
    """The sequence, filtered; rotations as axis-angle relative to the neutral frame, far from wrap-around."""
    if method == "none":
        return sequence

    def filtered(values: np.ndarray) -> np.ndarray:
        return smoothed(values.reshape(len(values), -1), method, sequence.fps).reshape(values.shape)

    def filtered_rotations(rotations: np.ndarray) -> np.ndarray:
        base = Rotation.from_rotvec(rotations[neutral])
        return (
            Rotation.from_rotvec(filtered((Rotation.from_rotvec(rotations) * base.inv()).as_rotvec())) * base
        ).as_rotvec()

    joints = [
        filtered_rotations(sequence.joint_rotations[:, joint]) for joint in range(sequence.joint_rotations.shape[1])
    ]
    cameras = sequence.cameras
    if cameras is not None:
        views = cameras.world_to_camera.copy()
        rotations = filtered_rotations(Rotation.from_matrix(views[:, :3, :3]).as_rotvec())
        views[:, :3, :3] = Rotation.from_rotvec(rotations).as_matrix()
        views[:, :3, 3] = filtered(views[:, :3, 3])
        cameras = Cameras(views, cameras.intrinsics, cameras.size)
    return dataclasses.replace(
        sequence,
        expression=filtered(sequence.expression),
        scores=None if sequence.scores is None else filtered(interpolated(sequence.scores)),
        joint_rotations=np.stack(joints, axis=1) if joints else sequence.joint_rotations,
        eyelids=filtered(sequence.eyelids),
        translation=filtered(sequence.translation),
        cameras=cameras,
    )


def limit_to_training_range(
    sequence: DrivingSequence, seen: DrivingSequence, neutral: int, margin: float
) -> DrivingSequence:
    """The sequence kept near the training range: unchanged inside it, smoothly saturating beyond it.

    Args:
        sequence: Sequence to limit.
        seen: Training frames.
        neutral: Row of `seen` from which joint angles are measured.
        margin: Width of the zone beyond the range, as a fraction of the range.
    """
    joints = [
        _limited_rotation(sequence.joint_rotations[:, joint], seen.joint_rotations[:, joint], neutral, margin)
        for joint in range(sequence.joint_rotations.shape[1])
    ]
    return dataclasses.replace(
        sequence,
        expression=soft_clip(sequence.expression, seen.expression, margin),
        joint_rotations=np.stack(joints, axis=1) if joints else sequence.joint_rotations,
        eyelids=soft_clip(sequence.eyelids, seen.eyelids, margin),
    )


def soft_clip(
    values: Float[np.ndarray, "T D"], seen: Float[np.ndarray, "S D"], margin: float
) -> Float[np.ndarray, "T D"]:
    """Identity within the range of `seen` per column; beyond it tanh, bounded by `margin` times the range."""
    low, high = seen.min(axis=0), seen.max(axis=0)
    zone = margin * np.maximum(high - low, np.median(high - low) if values.shape[1] else 0.0) + 1e-9
    inside = np.clip(values, low, high)
    return inside + zone * np.tanh((values - inside) / zone)


def _limited_rotation(
    rotations: Float[np.ndarray, "T 3"], seen: Float[np.ndarray, "S 3"], neutral: int, margin: float
) -> Float[np.ndarray, "T 3"]:
    """Rotations whose angle from the neutral one stays near the largest in `seen`."""
    base = Rotation.from_rotvec(seen[neutral])
    turns = (Rotation.from_rotvec(rotations) * base.inv()).as_rotvec()
    angles = np.linalg.norm(turns, axis=1, keepdims=True)
    most = (Rotation.from_rotvec(seen) * base.inv()).magnitude().max()
    kept = soft_clip(angles, np.array([[0.0], [most]]), margin)
    return (Rotation.from_rotvec(turns * (kept / np.maximum(angles, 1e-12))) * base).as_rotvec()
