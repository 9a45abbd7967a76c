"""How well the tracked mesh lies over the masks, under any hypothesis about the tracking."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float

from ggavatar.capture import Capture, Tracking
from ggavatar.head.model import HeadModel
from preprocess.hypotheses import Hypothesis
from preprocess.posing import overlap, posed_vertices, project, silhouette

SIDE = 144
FRAMES = 20


@dataclass(frozen=True)
class Evidence:
    """Posed vertices and small masks of some frames, against which hypotheses are weighed.

    Attributes:
        rows: Rows of the tracking.
        vertices: Posed vertices of those rows under the tracking as it is, m.
        masks: Their masks at reduced size.
        faces: Of the mesh.
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
        """IoU of silhouette and mask in every sampled frame, if the hypothesis were true and undone."""
        corrected = hypothesis.correct(tracking, *self.size)
        result = []
        for row, vertices, mask in zip(self.rows, self.vertices, self.masks, strict=True):
            # The vertices hold the old translation; a hypothesis may change it.
            moved = vertices - tracking.translation[row] + corrected.translation[row]
            pixels, depth = project(moved, corrected.intrinsics[row], corrected.world_to_camera[row])
            drawn = silhouette(pixels * self.scale, depth, self.faces, (mask.shape[1], mask.shape[0]))
            result.append(_overlap_above(drawn, mask))
        return np.array(result)


def _overlap_above(drawn: np.ndarray, seen: np.ndarray) -> float:
    """IoU, the body below a mesh that ends inside the picture left out."""
    rows = np.flatnonzero(drawn.any(axis=1))
    if not len(rows):
        return 0.0
    # Only where the mesh is of a person's size in the picture; a speck high up must not cut its own measure.
    last = rows[-1] + 1 if rows[-1] - rows[0] > 0.5 * np.count_nonzero(seen.any(axis=1)) else len(drawn)
    return overlap(drawn[:last], seen[:last])


def gather(capture: Capture, head: HeadModel) -> Evidence:
    """Sample frames over the whole clip."""
    rows = sorted({round(place) for place in np.linspace(0, len(capture.frames) - 1, min(FRAMES, len(capture.frames)))})
    scale = SIDE / max(capture.width, capture.height)
    small = (max(1, round(capture.width * scale)), max(1, round(capture.height * scale)))
    masks = [cv2.resize(capture.mask(capture.frames[row]), small, interpolation=cv2.INTER_AREA) > 127 for row in rows]
    vertices = [posed_vertices(head, capture.tracking, row) for row in rows]
    return Evidence(
        tuple(rows), tuple(vertices), tuple(masks), head.faces.numpy(), scale, (capture.width, capture.height)
    )


@dataclass(frozen=True)
class Ranking:
    """Hypotheses by how well they explain the masks, best first, with mean IoU.

    Attributes:
        scores: Name and mean IoU.
        best: The hypothesis that is clearly better than the tracking as it is, or None.
    """

    scores: tuple[tuple[str, float], ...]
    best: Hypothesis | None


def rank(evidence: Evidence, tracking: Tracking, hypotheses: Sequence[Hypothesis]) -> Ranking:
    """Weigh hypotheses; the first is the tracking as it is.

    Clear means by 0.01 and three standard errors over the frames.
    """
    overlaps = [evidence.overlaps(tracking, hypothesis) for hypothesis in hypotheses]
    order = sorted(range(len(hypotheses)), key=lambda index: -overlaps[index].mean())
    scores = tuple((hypotheses[index].name, float(overlaps[index].mean())) for index in order)
    lead = overlaps[order[0]] - overlaps[0]
    error = lead.std() / np.sqrt(max(len(lead), 1))
    clear = order[0] != 0 and lead.mean() > max(0.01, 3 * error)
    return Ranking(scores, hypotheses[order[0]] if clear else None)
