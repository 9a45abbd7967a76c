"""One pass over a clip's pictures: everything that tracking needs of them, in little memory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ggavatar.errors import InputError
from ggavatar.io.ordered_map import ordered_map
from ggavatar.landmarks.tracker import LandmarkTracker
from preprocess.tracking.face.clip_fit import Clip
from preprocess.tracking.geometry.rigid import nearest_true
from preprocess.tracking.head.silhouette_fit import Outlines, chosen_rows, reduce_mask
from preprocess.tracking.pose.outline_cue import Edges, reduced_distances
from preprocess.tracking.pose.texture_images import SkinPictures, skin_picture
from preprocess.tracking.torso.texture import TorsoTracker
from preprocess.tracking.torso.torso import TorsoMotions, torso_motions

ENOUGH_FRAMES = 8


@dataclass(frozen=True)
class Watched:
    """What one pass over the pictures gave.

    Attributes:
        clip: Landmarks.
        torso: How its image moves.
        outlines: Masks of a few frames.
        edges: Outlines of all frames, more coarsely.
        skin: The face's texture in all frames.
    """

    clip: Clip
    torso: TorsoMotions
    outlines: Outlines
    edges: Edges
    skin: SkinPictures


def watch(images: Sequence[np.ndarray], masks: Sequence[np.ndarray], fps: float, tracker: LandmarkTracker) -> Watched:
    """Landmarks and torso motion of every frame, holding a few pictures at a time."""
    torso, points, scores, texture, kept, distances, skin = TorsoTracker(), [], [], [], [], [], []
    rows, size = chosen_rows(len(images)), (0, 0)
    pictures = ordered_map(lambda index: (images[index], masks[index]), range(len(images)))
    for index, (image, mask) in enumerate(pictures):
        size = (image.shape[1], image.shape[0])
        found = tracker.landmarks(image)
        points.append(None if found is None else found.points)
        scores.append(np.zeros(52) if found is None else found.blendshapes)
        texture.append(torso.motion(image, mask, points[-1]))
        distances.append(reduced_distances(mask))
        skin.append(skin_picture(image, points[-1]))
        if index in rows:
            kept.append(reduce_mask(mask))
    seen = np.array([here is not None for here in points])
    if seen.sum() < ENOUGH_FRAMES:
        raise InputError(
            f"a face was found in {seen.sum()} of {len(seen)} frames, expected at least {ENOUGH_FRAMES}; "
            "is the clip a portrait video?"
        )
    nearest = nearest_true(seen)
    filled = np.stack([points[index] for index in nearest])
    clip = Clip(filled, np.stack(scores)[nearest].astype(np.float64), seen, size, fps)
    edges = Edges(np.stack(distances), distances[0].shape[1] / size[0])
    faces = [(float(shape[:, 1].min()), float(shape[:, 1].max())) for shape in filled]
    motions = torso_motions(texture, edges, faces, fps)
    outlines = Outlines(rows, np.stack(kept), kept[0].shape[1] / size[0])
    return Watched(clip, motions, outlines, edges, SkinPictures.of(skin))
