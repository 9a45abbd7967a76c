"""Quality measures of a capture without ground truth: lens, jitter, blur, repeated frames, range of motion."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8

from ggavatar.data.capture import Capture, Tracking
from ggavatar.head.model import HeadModel
from ggavatar.io.ordered_map import ordered_map
from preprocess.evidence.pictures import MAX_REPEAT_DIFFERENCE
from preprocess.tracking.geometry.projection import posed_vertices, project
from preprocess.tracking.pose.bundle_adjustment import PRIOR_DISTANCE

MIN_RELATIVE_SHARPNESS = 0.3
"""Sharpness, relative to the clip's median, below which a frame counts as blurred."""


def lens(capture: Capture) -> dict[str, float]:
    """Field of view, pixel aspect ratio and principal point.

    The field of view is in degrees; the principal point is relative to the source's center, as a fraction of the
    capture's width and height.
    """
    intrinsics = np.median(capture.tracking.intrinsics.astype(np.float64), axis=0)
    crop = capture.source.get("crop", {}) if isinstance(capture.source.get("crop"), dict) else {}
    center = _source_center(capture, crop)
    return {
        "field_of_view": float(np.degrees(2 * np.arctan(max(capture.width, capture.height) / (2 * intrinsics[0, 0])))),
        "aspect": float(intrinsics[1, 1] / intrinsics[0, 0]),
        "principal_x": float((intrinsics[0, 2] - center[0]) / capture.width),
        "principal_y": float((intrinsics[1, 2] - center[1]) / capture.height),
    }


def _source_center(capture: Capture, crop: dict[str, Any]) -> tuple[float, float]:
    """The source's center in px of the capture; the capture's own center if the crop is not known."""
    keys = ("x", "y", "width", "height")
    known = all(isinstance(crop.get(key), int) for key in keys) and crop["width"] > 0 and crop["height"] > 0
    size = [capture.source.get(key) for key in ("width", "height")]
    if not known or not all(isinstance(value, int) for value in size):
        return capture.width / 2, capture.height / 2
    x = (int(size[0] or 0) / 2 - crop["x"]) * capture.width / crop["width"]
    y = (int(size[1] or 0) / 2 - crop["y"]) * capture.height / crop["height"]
    return x, y


def head_positions(tracking: Tracking) -> Float[np.ndarray, "T 3"]:
    """The head's position in camera coordinates, m."""
    rotations, offsets = tracking.world_to_camera[:, :3, :3], tracking.world_to_camera[:, :3, 3]
    return np.einsum("tij,tj->ti", rotations, tracking.translation) + offsets


def usual_focal(tracking: Tracking) -> float:
    """Focal length, px, that shows the head at the same size from the distance at which people are usually filmed."""
    return float(np.median(tracking.intrinsics[:, 0, 0] / head_positions(tracking)[:, 2]) * PRIOR_DISTANCE)


def jitter(tracking: Tracking) -> dict[str, float]:
    """Median second difference of head position (px in the image) and direction (degrees), scaled to one frame's error.

    0 for any steady motion.
    """
    centers = head_positions(tracking)
    image = np.einsum("tij,tj->ti", tracking.intrinsics, centers)
    pixels = image[:, :2] / np.where(np.abs(image[:, 2:]) > 1e-6, image[:, 2:], 1e-6)
    if len(pixels) < 3:
        return {"pixels": 0.0, "degrees": 0.0}
    second = np.diff(pixels, 2, axis=0) / np.sqrt(6)
    forward = tracking.world_to_camera[:, :3, 2].astype(np.float64)
    turned = np.degrees(np.diff(forward, 2, axis=0)) / np.sqrt(6)
    # The median ignores real sudden motion.
    return {
        "pixels": float(np.median(np.linalg.norm(second, axis=1))),
        "degrees": float(np.median(np.linalg.norm(turned, axis=1))),
    }


def eye_divergence(tracking: Tracking) -> float:
    """Mean angle by which the eyes diverge, degrees; human eyes are parallel or converge (negative)."""
    if tracking.joint_rotations.shape[1] < 5:
        return 0.0
    return float(np.degrees((tracking.joint_rotations[:, 3, 1] - tracking.joint_rotations[:, 4, 1]).mean()))


def coverage(tracking: Tracking) -> dict[str, Any]:
    """Range of motion in the clip: active expressions and their spread, yaw range and jaw range in degrees."""
    spread = tracking.expression.std(axis=0)
    forward = tracking.world_to_camera[:, :3, 2].astype(np.float64)
    yaw = np.degrees(np.arctan2(forward[:, 0], np.maximum(np.abs(forward[:, 2]), 1e-6)))
    jaw = tracking.joint_rotations[:, 2, 0] if tracking.joint_rotations.shape[1] > 2 else np.zeros(1)
    return {
        "moving_expressions": int(np.count_nonzero(spread > 0.05 * max(spread.max(initial=0), 1e-9))),
        "expression_spread": float(spread.mean()) if spread.size else 0.0,
        "yaw_range": float(np.ptp(yaw)),
        "jaw_range": float(np.degrees(np.ptp(jaw))),
    }


def image_quality(capture: Capture, head: HeadModel) -> dict[str, Any]:
    """Blurred and repeated frames and the median sharpness, which is measured within the masked person."""
    sharpness, repeated, before = [], [], None
    measured = ordered_map(lambda number: _gray_and_sharpness(capture, number), capture.frames)
    for number, (gray, detail) in zip(capture.frames, measured, strict=True):
        sharpness.append(detail)
        if before is not None and float(cv2.absdiff(gray, before).mean()) < MAX_REPEAT_DIFFERENCE:
            repeated.append(number)
        before = gray
    typical = float(np.median(sharpness))
    blurred = [
        number
        for number, value in zip(capture.frames, sharpness, strict=True)
        if value < MIN_RELATIVE_SHARPNESS * typical
    ]
    return {"sharpness": typical, "blurred": blurred, "repeated": repeated}


def _gray_and_sharpness(capture: Capture, number: int) -> tuple[UInt8[np.ndarray, "H W"], float]:
    """One image in gray and its sharpness within the person."""
    gray = cv2.cvtColor(capture.image(number), cv2.COLOR_RGB2GRAY)
    mask = cv2.erode(capture.mask(number), np.ones((5, 5), np.uint8)) > 127
    return gray, float(cv2.Laplacian(gray, cv2.CV_32F)[mask].std()) if mask.any() else 0.0


def landmark_error(capture: Capture, head: HeadModel) -> float | None:
    """Median distance between projected and detected landmarks, px; None without landmarks or their embedding."""
    landmarks, embedding = capture.tracking.landmarks, landmark_embedding(head)
    if landmarks is None or embedding is None or landmarks.shape[1] < len(embedding[0]):
        return None
    (corners, weights), distances = embedding, []
    placed = np.flatnonzero(weights.any(axis=1))
    for row in range(0, len(capture.frames), max(1, len(capture.frames) // 100)):
        vertices = posed_vertices(head, capture.tracking, row)
        points = np.einsum("lk,lkc->lc", weights[placed], vertices[corners[placed]])
        pixels, _ = project(points, capture.tracking.intrinsics[row], capture.tracking.world_to_camera[row])
        distances.append(np.linalg.norm(pixels - landmarks[row, placed], axis=1))
    found = np.concatenate(distances)
    return float(np.nanmedian(found)) if np.isfinite(found).any() else None


def landmark_embedding(head: HeadModel) -> tuple[Int[np.ndarray, "L K"], Float[np.ndarray, "L K"]] | None:
    """Vertices and weights of the head's landmarks (docs/capture-format.md); None if it has none."""
    rows = head.regions.get("landmarks")
    if rows is None or not len(rows):
        return None
    if head.landmark_weights is None:
        return rows.numpy()[:, None], np.ones((len(rows), 1))
    return rows.numpy().reshape(-1, 3), head.landmark_weights.numpy().astype(np.float64)
