"""Refinement: a short avatar learns the person while the tracking follows its gradients, all frames together."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from ggavatar.data.capture import Tracking
from ggavatar.head.model import HeadModel
from preprocess.refinement.corrections import Corrections, corrections_of
from preprocess.refinement.curvature import mean_information
from preprocess.refinement.landmarks import LandmarkTerm
from preprocess.refinement.pictures import Pictures
from preprocess.refinement.short_avatar import ShortAvatar
from preprocess.refinement.solve import Regularity, regularity, smooth_step
from preprocess.tracking.geometry.rigid import evenly_spaced

FARTHEST = 3.0
"""Median correction, in standard deviations of its prior, beyond which avatar and tracking have drifted apart."""
SAMPLED = 12
"""Pictures whose information is averaged."""


@dataclass(frozen=True)
class RefinementOptions:
    """Length of the refinement."""

    warm_steps: int = 400
    """Least number of steps in which only the avatar learns; a blurred one would mislead. They are whole passes."""
    epochs: int = 8
    """Passes in which the tracking moves too, once at the end of each."""
    relaxation: float = 1.5
    """Factor on the steps of all passes but the last two: avatar and tracking follow each other, which is slow."""
    longest: float = 4.0
    """Longest step of a pass, in units of the corrections: the quadratic model holds for no more."""
    measured: tuple[int, ...] = (0, 2, 5)
    """Passes before which the pictures' information is measured."""


@dataclass(frozen=True)
class Refined:
    """A refined tracking and what changed.

    Attributes:
        tracking: The refined one.
        misfits: Mean misfit of every pass.
        settled: Whether the corrections stayed within what a tracker gets wrong; if not, the tracking is as it was.
        report: For the capture, as plain JSON values.
    """

    tracking: Tracking
    misfits: tuple[float, ...]
    settled: bool
    report: dict[str, Any]


def refine(
    head: HeadModel,
    tracking: Tracking,
    pictures: Pictures,
    fps: float,
    options: RefinementOptions = RefinementOptions(),
    advance: Callable[[int, int], None] = lambda done, total: None,
) -> Refined:
    """Refine a tracking against pictures of its frames.

    Frames without a picture follow the smooth course of the corrections. Landmarks and the identity stay as they are.

    Args:
        head: The head model that the tracking belongs to.
        tracking: As tracked.
        pictures: Of some or all of its frames.
        fps: Frames per second.
        options: Length.
        advance: Called with the passes done and in all.
    """
    corrections = corrections_of(head, tracking)
    landmarks = LandmarkTerm.of(head, tracking)
    warm = math.ceil(options.warm_steps / len(pictures.rows))
    total = warm + options.epochs
    avatar = ShortAvatar(head, tracking, pictures, total * len(pictures.rows))
    values, misfits = np.zeros((len(tracking.expression), corrections.count)), []
    for done in range(warm):
        misfits.append(avatar.epoch(tracking, with_gradients=False).misfit)
        advance(done + 1, total)
    for epoch in range(options.epochs):
        if epoch == 0 or epoch in options.measured:
            known = _measured(avatar, landmarks, tracking, corrections, values, fps)
        moved = corrections.moved(tracking, values)
        found = avatar.epoch(moved, with_gradients=True)
        gradients = (
            found.gradients if landmarks is None else _sum(found.gradients, landmarks.gradients(moved, pictures.rows))
        )
        gradient = corrections.pulled_back(tracking, values, gradients)
        factor = 1.0 if epoch >= options.epochs - 2 else options.relaxation
        step = factor * smooth_step(values, known.information, gradient, known.regularity)
        values = values + step * min(1.0, options.longest / max(float(np.abs(step).max()), 1e-9))
        misfits.append(found.misfit)
        advance(warm + epoch + 1, total)
    settled = bool(np.median(np.abs(values) / corrections.per_number("prior"), axis=0).max(initial=0.0) < FARTHEST)
    moved = finished(corrections.moved(tracking, values), tracking) if settled else tracking
    report = report_of(pictures, tracking, moved, corrections.split(values), misfits)
    return Refined(moved, tuple(misfits), settled, report)


@dataclass(frozen=True)
class _Known:
    """What every frame tells about its corrections, and what is known without it."""

    information: Float[np.ndarray, "T C C"]
    regularity: Regularity


def _measured(
    avatar: ShortAvatar,
    landmarks: LandmarkTerm | None,
    tracking: Tracking,
    corrections: Corrections,
    values: np.ndarray,
    fps: float,
) -> _Known:
    """The mean information of pictures and of landmarks, in the frames that have them."""
    places = evenly_spaced(len(avatar.pictures.rows), SAMPLED).tolist()
    picture = mean_information(avatar, tracking, corrections, values, places)
    typical, total = picture, np.zeros((len(values), *picture.shape))
    total[list(avatar.pictures.rows)] = picture
    if landmarks is not None:
        rows = [avatar.pictures.rows[place] for place in places]
        face = landmarks.information(tracking, corrections, values, rows)
        typical = typical + face
        total[[row for row in avatar.pictures.rows if landmarks.found[row]]] += face
    stds, cutoffs = corrections.per_number("prior"), corrections.per_number("cutoff")
    return _Known(total, regularity(typical, stds, cutoffs, fps))


def _sum(first: dict[str, np.ndarray], second: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {name: first[name] + second[name] for name in first}


def finished(moved: Tracking, tracking: Tracking) -> Tracking:
    """The refined tracking with lids limited to what the tracker itself allows, or found."""
    low, high = min(float(tracking.eyelids.min()), 0.0), max(float(tracking.eyelids.max()), 1.0)
    return dataclasses.replace(moved, eyelids=np.clip(moved.eyelids, low, high))


def report_of(
    pictures: Pictures,
    before: Tracking,
    after: Tracking,
    parts: dict[str, np.ndarray],
    misfits: list[float],
) -> dict[str, Any]:
    """What was compared and how far the tracking moved: medians over the frames."""
    turns = Rotation.from_matrix(
        before.world_to_camera[:, :3, :3].transpose(0, 2, 1) @ after.world_to_camera[:, :3, :3]
    ).magnitude()
    found = {
        "pictures": len(pictures.rows),
        "picture_size": list(pictures.size),
        "misfit": {"first": round(misfits[0], 2), "last": round(misfits[-1], 2)},
        "head_degrees": round(float(np.degrees(np.median(turns))), 3),
        "head_mm": round(float(1000 * np.median(np.linalg.norm(parts["head"][:, 3:], axis=1))), 3),
    }
    for name in ("torso", "gaze", "jaw"):
        if name in parts:
            angles = np.linalg.norm(parts[name][:, :3], axis=1)
            found[f"{name}_degrees"] = round(float(np.degrees(np.median(angles))), 3)
    return found
