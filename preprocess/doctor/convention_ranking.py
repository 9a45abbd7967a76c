"""Tests of convention hypotheses: silhouette overlap of mesh and masks, and brightness constancy under the mesh."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from jaxtyping import Bool, Float

from ggavatar.data.capture import Capture, Tracking
from ggavatar.head.model import HeadModel
from ggavatar.io.ordered_map import ordered_map
from preprocess.doctor.conventions import AXES, OTHERS, Hypothesis
from preprocess.doctor.frame_offset import brightness_changes, find_offset, mean_change
from preprocess.tracking.geometry.projection import mask_iou, posed_vertices, project, silhouette

SIDE = 128
"""Longer side of the reduced masks, px."""
FRAMES = 12
"""How many frames are sampled."""
MINIMUM_IOU = 0.42
"""Mean IoU that a hypothesis must exceed to be accepted: a huge head overlaps every person to some extent."""
MAX_CACHED_IMAGES = 128
"""How many images are kept in memory while hypotheses are compared."""
IOU_TIE_MARGIN = 0.05
"""Difference in IoU below which the brightness under the mesh decides instead of the silhouettes."""


@dataclass(frozen=True)
class ConventionTest:
    """Posed vertices and small masks of sampled frames, against which hypotheses are tested.

    Attributes:
        rows: Sampled rows of the tracking.
        vertices: Posed vertices of those rows under the tracking as it is, m.
        masks: Masks of those rows at reduced size.
        faces: Triangles of the mesh.
        scale: Size of the reduced masks relative to the capture.
        size: Width and height of the capture, px.
    """

    rows: tuple[int, ...]
    vertices: tuple[Float[np.ndarray, "V 3"], ...]
    masks: tuple[Bool[np.ndarray, "h w"], ...]
    faces: np.ndarray
    scale: float
    size: tuple[int, int]

    def overlaps(self, tracking: Tracking, hypothesis: Hypothesis) -> Float[np.ndarray, " N"]:
        """IoU of silhouette and mask in every sampled frame with the hypothesis's mistake undone."""
        corrected = hypothesis.correct(tracking, *self.size)

        def score(view: tuple[int, np.ndarray, np.ndarray]) -> float:
            row, vertices, mask = view
            # The vertices include the original translation; a hypothesis may change it.
            moved = vertices - tracking.translation[row] + corrected.translation[row]
            pixels, depth = project(moved, corrected.intrinsics[row], corrected.world_to_camera[row])
            covered = silhouette(pixels * self.scale, depth, self.faces, (mask.shape[1], mask.shape[0]))
            return _overlap_above(covered, mask)

        return np.array(list(ordered_map(score, zip(self.rows, self.vertices, self.masks, strict=True))))


def _overlap_above(covered: np.ndarray, mask: np.ndarray) -> float:
    """IoU of silhouette and mask without the body below a mesh that ends inside the image."""
    rows = np.flatnonzero(covered.any(axis=1))
    if not len(rows):
        return 0.0
    # Only if the silhouette is about as tall as the person; a speck high up must not exclude the rest of the mask.
    last = rows[-1] + 1 if rows[-1] - rows[0] > 0.5 * np.count_nonzero(mask.any(axis=1)) else len(covered)
    return mask_iou(covered[:last], mask[:last])


def prepare_convention_test(capture: Capture, head: HeadModel) -> ConventionTest:
    """A convention test on frames sampled evenly over the whole clip."""
    count = min(FRAMES, len(capture.frames))
    rows = sorted({round(position) for position in np.linspace(0, len(capture.frames) - 1, count)})
    scale = SIDE / max(capture.width, capture.height)
    small = (max(1, round(capture.width * scale)), max(1, round(capture.height * scale)))
    masks = [cv2.resize(capture.mask(capture.frames[row]), small, interpolation=cv2.INTER_AREA) > 127 for row in rows]
    vertices = [posed_vertices(head, capture.tracking, row) for row in rows]
    return ConventionTest(
        tuple(rows), tuple(vertices), tuple(masks), head.faces.numpy(), scale, (capture.width, capture.height)
    )


def photometric_alternative(capture: Capture, head: HeadModel, scores: dict[str, float]) -> Hypothesis | None:
    """A hypothesis that explains the brightness under the mesh clearly better and the silhouettes about as well.

    Silhouettes cannot distinguish a head that turns left from one that turns right; the image of the face can.

    Args:
        capture: The capture.
        head: Its head.
        scores: Mean IoU by hypothesis name.
    """
    frames, now = capture.frames, capture.tracking
    image = lru_cache(maxsize=MAX_CACHED_IMAGES)(capture.image)
    own = brightness_changes(head, now, frames, image)
    found: tuple[float, Hypothesis] | None = None
    for hypothesis in (*AXES[1:], *OTHERS):
        corrected = hypothesis.correct(now, capture.width, capture.height)
        if scores[hypothesis.name] < scores["as-is"] - IOU_TIE_MARGIN or _same_cameras(now, corrected):
            continue
        lead = own - brightness_changes(head, corrected, frames, image)
        lead = lead[np.isfinite(lead)]
        if len(lead) < 4 or lead.mean() < max(0.15 * mean_change(own), 3 * lead.std() / np.sqrt(len(lead))):
            continue
        if found is None or lead.mean() > found[0]:
            found = (float(lead.mean()), hypothesis)
    return found[1] if found else None


def explained_by_frame_offset(capture: Capture, head: HeadModel, hypothesis: Hypothesis) -> bool:
    """Whether a frame offset explains the brightness under the mesh better than the hypothesis does.

    The silhouettes of a head that lags behind the video may by chance fit a wrong convention slightly better.
    """
    frames, now = capture.frames, capture.tracking
    corrected = hypothesis.correct(now, capture.width, capture.height)
    if np.allclose(now.world_to_camera, corrected.world_to_camera, atol=1e-6):
        return False
    shifted = find_offset(head, now, frames, frames, capture.image).scores
    change = mean_change(brightness_changes(head, corrected, frames, capture.image))
    return bool(shifted) and min(shifted.values()) < change


def _same_cameras(left: Tracking, right: Tracking) -> bool:
    return np.allclose(left.intrinsics, right.intrinsics) and np.allclose(
        left.world_to_camera, right.world_to_camera, atol=1e-6
    )


@dataclass(frozen=True)
class Ranking:
    """Hypotheses ranked by how well they explain the masks.

    Attributes:
        scores: Name and mean IoU of every hypothesis, best first.
        best: The hypothesis that is clearly better than the tracking as it is, or None.
    """

    scores: tuple[tuple[str, float], ...]
    best: Hypothesis | None


def rank_hypotheses(test: ConventionTest, tracking: Tracking, hypotheses: Sequence[Hypothesis]) -> Ranking:
    """Rank hypotheses, of which the first is the tracking as it is.

    Clearly better means by 0.01 IoU and by three standard errors over the frames.
    """
    overlaps = [test.overlaps(tracking, hypothesis) for hypothesis in hypotheses]
    order = sorted(range(len(hypotheses)), key=lambda index: -overlaps[index].mean())
    scores = tuple((hypotheses[index].name, float(overlaps[index].mean())) for index in order)
    lead = overlaps[order[0]] - overlaps[0]
    error = lead.std() / np.sqrt(max(len(lead), 1))
    clear = order[0] != 0 and lead.mean() > max(0.01, 3 * error) and overlaps[order[0]].mean() > MINIMUM_IOU
    return Ranking(scores, hypotheses[order[0]] if clear else None)
