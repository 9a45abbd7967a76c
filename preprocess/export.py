"""Export of captures to the layouts of other trainers: GaussianAvatars (VHAP's export) and FlashAvatar.

Both layouts assume FLAME: a capture with another head can be written, but those trainers would apply its coefficients
to FLAME. `ggavatar-export CAPTURE --format vhap | flash-avatar` finds these functions through entry points
(pyproject.toml), so that ggavatar does not import this package.
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
    """A capture's tracking as a record with FLAME's five joints; frames are numbered from 0 without gaps.

    Raises:
        InputError: The head has fewer joints.
    """
    tracking = capture.tracking
    if tracking.joint_rotations.shape[1] < FLAME_JOINTS:
        raise InputError(
            f"{capture.folder}: expected a head with at least FLAME's 5 joints, found "
            f"{tracking.joint_rotations.shape[1]}; this layout cannot hold the capture"
        )
    beyond = np.abs(tracking.joint_rotations[:, FLAME_JOINTS:]).max(initial=0)
    notes = ["joints beyond FLAME's five are left out"] if beyond > 1e-6 else []
    if not capture.head_version.startswith("flame"):
        notes.append(f"the head is {capture.head_version}, not FLAME: other trainers would pose the wrong head")
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
    """The record for images shifted so that the principal point is their center, and the crop that shifts them.

    The images keep their size and are padded. GaussianAvatars and FlashAvatar ignore the principal point. One shift is
    used for the whole clip: that of the median principal point, in whole px.
    """
    centers = record.intrinsics[:, :2, 2]
    shift = np.round(np.median(centers, axis=0) - [record.width / 2, record.height / 2]).astype(int)
    crop = Crop(int(shift[0]), int(shift[1]), record.width, record.height, record.width, record.height)
    return dataclasses.replace(record, intrinsics=crop.intrinsics(record.intrinsics)), crop


def with_pose_in_camera(record: TrackingRecord, head: HeadModel) -> TrackingRecord:
    """The record with the head's root rotation and translation moved into the camera, as metrical-tracker stores it.

    FLAME's root rotates about joint 0 of the shaped head, not about the origin.

    Raises:
        InputError: The neck is rotated, which such a format cannot hold.
    """
    if np.abs(record.joint_rotations[:, 1]).max() > 1e-6:
        raise InputError(
            "the neck joint is rotated, but formats that store the head pose in the camera cannot hold that; "
            "track the video with a still neck"
        )
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
    """The record with a static camera 1 m in front of the head and all motion in FLAME's root, as VHAP stores it.

    The inverse of `with_pose_in_camera`, which is applied first.
    """
    in_camera = with_pose_in_camera(record, head)
    static = np.diag([1.0, -1.0, -1.0, 1.0])
    static[2, 3] = 1.0
    turns = static[:3, :3].T @ in_camera.world_to_camera[:, :3, :3]
    roots = _root_joints(record, head)
    moves = (in_camera.world_to_camera[:, :3, 3] - static[:3, 3]) @ static[:3, :3]
    moves = moves - roots + np.einsum("tij,tj->ti", turns, roots)
    joints = in_camera.joint_rotations.copy()
    joints[:, 0] = matrix_to_axis_angle(torch.from_numpy(turns)).numpy()
    poses = np.tile(static, (len(turns), 1, 1))
    return dataclasses.replace(in_camera, world_to_camera=poses, joint_rotations=joints, translation=moves)


def export_gaussian_avatars(capture: Capture, folder: Path) -> Mapping[str, object]:
    """Write a folder that GaussianAvatars trains on: VHAP's files, images on white, and masks.

    The principal point is moved to the image center.

    Returns:
        The number of "frames", and under "notes" what could not be represented.

    Raises:
        InputError: The folder is not empty, or the layout cannot hold the tracking.
    """
    _require_new(folder)
    record, crop = center_principal_point(to_tracking_record(capture))
    record = with_pose_in_flame(record, load_head(capture.head_path))
    vhap.write(folder, record)
    for row, number in enumerate(capture.frames):
        mask = crop.image(capture.mask(number))
        alpha = mask[..., None].astype(np.float32) / 255
        on_white = np.round(crop.image(capture.image(number)) * alpha + 255 * (1 - alpha)).astype(np.uint8)
        write_png(folder / "images" / f"{row:05d}_00.png", on_white)
        write_png(folder / "fg_masks" / f"{row:05d}_00.png", mask)
    lids = ("eyelids cannot be stored",) if np.abs(record.eyelids).max() > 1e-6 else ()
    return {"notes": [*record.notes, *lids], "frames": len(capture.frames)}


def export_flash_avatar(capture: Capture, folder: Path) -> Mapping[str, object]:
    """Write FlashAvatar's layout: `checkpoint/%05d.frame` numbered from 0, `imgs` and `alpha` from 1, 512 × 512 px.

    The head, neck and mouth parsing masks that its training also reads are not made here.

    Returns:
        The number of "frames", and under "notes" what could not be represented.

    Raises:
        InputError: The folder is not empty, the capture is too short (FlashAvatar tests on the last 500 frames) or not
            512 × 512 px, or the neck is rotated.
    """
    _require_new(folder)
    if (capture.width, capture.height) != (FLASH_AVATAR_SIDE, FLASH_AVATAR_SIDE):
        raise InputError(
            f"{capture.folder}: expected 512 × 512 px images for FlashAvatar, found "
            f"{capture.width}×{capture.height}; prepare the video again with --size 512"
        )
    if len(capture.frames) <= FLASH_AVATAR_TEST_FRAMES:
        raise InputError(
            f"{capture.folder}: expected more than {FLASH_AVATAR_TEST_FRAMES} frames, since FlashAvatar tests on the "
            f"last {FLASH_AVATAR_TEST_FRAMES} frames; found {len(capture.frames)}"
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
        raise InputError(f"{folder}: exists already; choose another folder with -o")
