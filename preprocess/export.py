"""A capture in the layouts of others' trainers: GaussianAvatars (VHAP's export) and FlashAvatar.

Both need FLAME: a capture whose head is not FLAME's can be written, but those trainers would pose another head with
its coefficients. `ggavatar-export CAPTURE --format vhap | flash-avatar` finds these functions as entry points
(pyproject.toml), so that ggavatar need not import this package.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float

from ggavatar.data.capture import Capture
from ggavatar.errors import InputError
from ggavatar.geometry.transforms import axis_angle_to_matrix, matrix_to_axis_angle
from ggavatar.head.files import load_head
from ggavatar.head.model import HeadModel
from ggavatar.io.images import write_jpeg, write_png
from preprocess.formats.importers import metrical_tracker, vhap
from preprocess.formats.tracking_record import FLAME_JOINTS, TrackingRecord
from preprocess.video.crop import Crop

FLASH_AVATAR_SIDE = 512
FLASH_AVATAR_TEST_FRAMES = 500


def to_tracking_record(capture: Capture) -> TrackingRecord:
    """A capture's tracking as a record: five FLAME joints, frames numbered from 0 without gaps."""
    tracking = capture.tracking
    if tracking.joint_rotations.shape[1] < FLAME_JOINTS:
        raise InputError(
            f"{capture.folder}: the head has {tracking.joint_rotations.shape[1]} joints, FLAME's layouts need 5"
        )
    beyond = np.abs(tracking.joint_rotations[:, FLAME_JOINTS:]).max(initial=0)
    notes = ["joints beyond FLAME's five are left out"] if beyond > 1e-6 else []
    if not capture.head_version.startswith("flame"):
        notes.append(f"the head is {capture.head_version}, not FLAME: others' trainers would pose another head")
    wide = {name: value.astype(np.float64) for name, value in tracking.arrays().items()}
    return TrackingRecord(
        numbers=np.arange(len(capture.frames)),
        width=capture.width,
        height=capture.height,
        intrinsics=wide["intrinsics"],
        world_to_camera=wide["world_to_camera"],
        expression=wide["expression"],
        joint_rotations=wide["joint_rotations"][:, :FLAME_JOINTS],
        eyelids=wide["eyelids"],
        translation=wide["translation"],
        shape=wide.get("shape"),
        version=capture.head_version,
        notes=tuple(notes),
    )


def center_principal_point(record: TrackingRecord) -> tuple[TrackingRecord, Crop]:
    """The record for images re-cropped so that the principal point is their center, and that crop (same size, padded).

    GaussianAvatars and FlashAvatar ignore the principal point; one for the whole clip is used, rounded to whole px.
    """
    centers = record.intrinsics[:, :2, 2]
    shift = np.round(np.median(centers, axis=0) - [record.width / 2, record.height / 2]).astype(int)
    crop = Crop(int(shift[0]), int(shift[1]), record.width, record.height, record.width, record.height)
    return dataclasses.replace(record, intrinsics=crop.intrinsics(record.intrinsics)), crop


def with_pose_in_camera(record: TrackingRecord, head: HeadModel) -> TrackingRecord:
    """The record with the head's root rotation and translation moved into the camera, as metrical-tracker has it.

    FLAME's root turns about joint 0 of the shaped head, not about the origin.

    Raises:
        InputError: The neck is turned, which such a format cannot hold.
    """
    if np.abs(record.joint_rotations[:, 1]).max() > 1e-6:
        raise InputError("the neck is turned; formats that pose the head by the camera cannot hold that")
    turns = axis_angle_to_matrix(torch.from_numpy(record.joint_rotations[:, 0])).numpy()
    roots = _root_joints(record, head)
    moves = record.translation + roots - np.einsum("tij,tj->ti", turns, roots)
    poses = record.world_to_camera.copy()
    poses[:, :3, :3] = record.world_to_camera[:, :3, :3] @ turns
    poses[:, :3, 3] += np.einsum("tij,tj->ti", record.world_to_camera[:, :3, :3], moves)
    joints = record.joint_rotations.copy()
    joints[:, 0] = 0
    return dataclasses.replace(
        record, world_to_camera=poses, joint_rotations=joints, translation=np.zeros_like(record.translation)
    )


def _root_joints(record: TrackingRecord, head: HeadModel) -> Float[np.ndarray, "T 3"]:
    """Joint 0 of the shaped head in every frame, m."""
    weights = head.joint_regressor[0].numpy().astype(np.float64)
    basis = np.einsum("v,vce->ec", weights, head.expression_basis.numpy().astype(np.float64))
    used = record.expression[:, : len(basis)]
    return weights @ head.template.numpy().astype(np.float64) + used @ basis[: used.shape[1]]


def with_pose_in_flame(record: TrackingRecord, head: HeadModel) -> TrackingRecord:
    """The record with a still camera 1 m in front of the head and all motion in FLAME's root.

    As VHAP has it (inverse of the above).
    """
    folded = with_pose_in_camera(record, head)
    still = np.diag([1.0, -1.0, -1.0, 1.0])
    still[2, 3] = 1.0
    turns = still[:3, :3].T @ folded.world_to_camera[:, :3, :3]
    roots = _root_joints(record, head)
    moves = (folded.world_to_camera[:, :3, 3] - still[:3, 3]) @ still[:3, :3]
    moves = moves - roots + np.einsum("tij,tj->ti", turns, roots)
    joints = folded.joint_rotations.copy()
    joints[:, 0] = matrix_to_axis_angle(torch.from_numpy(turns)).numpy()
    poses = np.tile(still, (len(turns), 1, 1))
    return dataclasses.replace(folded, world_to_camera=poses, joint_rotations=joints, translation=moves)


def export_gaussian_avatars(capture: Capture, folder: Path) -> Mapping[str, object]:
    """Write a folder GaussianAvatars trains on: VHAP's files, images on white and masks, the principal point center_principal_point.

    Returns:
        What could not be represented, under "notes".
    """
    _require_new(folder)
    record, crop = center_principal_point(to_tracking_record(capture))
    record = with_pose_in_flame(record, load_head(capture.head_path))
    vhap.write(folder, record)
    for row, number in enumerate(capture.frames):
        mask = crop.image(capture.mask(number))
        alpha = mask[..., None].astype(np.float32) / 255
        shown = np.round(crop.image(capture.image(number)) * alpha + 255 * (1 - alpha)).astype(np.uint8)
        write_png(folder / "images" / f"{row:05d}_00.png", shown)
        write_png(folder / "fg_masks" / f"{row:05d}_00.png", mask)
    lids = ("eyelids cannot be stored",) if np.abs(record.eyelids).max() > 1e-6 else ()
    return {"notes": [*record.notes, *lids], "frames": len(capture.frames)}


def export_flash_avatar(capture: Capture, folder: Path) -> Mapping[str, object]:
    """Write FlashAvatar's layout: `checkpoint/%05d.frame` counted from 0, `imgs` and `alpha` from 1, 512 × 512 px.

    The head-and-neck and mouth parsing of its training is not made here.

    Raises:
        InputError: Too short (FlashAvatar tests on the last 500 frames), not 512 × 512, or a turned neck.
    """
    _require_new(folder)
    if (capture.width, capture.height) != (FLASH_AVATAR_SIDE, FLASH_AVATAR_SIDE):
        raise InputError(
            f"{capture.folder}: FlashAvatar needs 512 × 512 px images, this capture has "
            f"{capture.width}×{capture.height}"
        )
    if len(capture.frames) <= FLASH_AVATAR_TEST_FRAMES:
        raise InputError(
            f"{capture.folder}: FlashAvatar tests on the last 500 frames, this capture has {len(capture.frames)}"
        )
    record, crop = center_principal_point(to_tracking_record(capture))
    record = with_pose_in_camera(record, load_head(capture.head_path))
    metrical_tracker.write(folder / "checkpoint", record)
    for row, number in enumerate(capture.frames, start=1):
        write_jpeg(folder / "imgs" / f"{row:05d}.jpg", crop.image(capture.image(number)), quality=98)
        mask = crop.image(capture.mask(number))
        write_jpeg(folder / "alpha" / f"{row:05d}.jpg", np.repeat(mask[..., None], 3, axis=2), quality=98)
    return {"notes": [*record.notes, "parsing masks are not made"], "frames": len(capture.frames)}


def _require_new(folder: Path) -> None:
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"{folder}: exists already; choose another folder")
