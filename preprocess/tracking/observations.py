"""One pass over a clip's frames: extracts all that tracking needs from them, in little memory."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ggavatar.errors import InputError
from ggavatar.io.ordered_map import ordered_map
from ggavatar.landmarks.tracker import Landmarks
from preprocess.tracking.face.clip_fit import ClipLandmarks
from preprocess.tracking.geometry.rigid import nearest_true_index
from preprocess.tracking.head.silhouette_fit import OutlineMasks, downscaled_mask, outline_frames
from preprocess.tracking.pose.outline_cue import OutlineDistances, signed_distances
from preprocess.tracking.pose.texture_images import SkinImages, skin_image
from preprocess.tracking.torso.texture import TorsoTracker
from preprocess.tracking.torso.torso import TorsoImageMotions, torso_image_motions

MINIMUM_FRAMES_WITH_FACE = 8


@dataclass(frozen=True)
class Observations:
    """What one pass over the frames extracts.

    Attributes:
        clip: Landmarks.
        torso: Motion of the torso in the image.
        outline_masks: Masks of a few frames.
        outline_distances: Distances to the outlines of all frames, at a lower resolution.
        skin: The face's texture in all frames.
    """

    clip: ClipLandmarks
    torso: TorsoImageMotions
    outline_masks: OutlineMasks
    outline_distances: OutlineDistances
    skin: SkinImages


def observe(
    images: Sequence[np.ndarray],
    masks: Sequence[np.ndarray],
    fps: float,
    landmarks: Callable[[int, np.ndarray], Landmarks | None],
) -> Observations:
    """Extract landmarks, outlines, texture and torso motion of every frame, with a few frames in memory at a time.

    Masks of frames without a face are not used.

    Args:
        images: The frames.
        masks: Their masks.
        fps: Frames per second.
        landmarks: Gives the landmarks of a frame from its index and image; called in order.

    Raises:
        InputError: A face was found in fewer than `MINIMUM_FRAMES_WITH_FACE` frames.
    """
    torso, points, scores, texture, distances, skin = TorsoTracker(), [], [], [], [], []
    kept_rows: list[int] = []
    kept: list[np.ndarray] = []
    rows, size = outline_frames(len(images)), (0, 0)
    frames = ordered_map(lambda index: (images[index], masks[index]), range(len(images)))
    for index, (image, mask) in enumerate(frames):
        size = (image.shape[1], image.shape[0])
        face = landmarks(index, image)
        points.append(None if face is None else face.points)
        scores.append(np.zeros(52) if face is None else face.blendshapes)
        texture.append(torso.motion(image, mask, points[-1]))
        distances.append(signed_distances(mask if face is not None else np.zeros_like(mask)))
        skin.append(skin_image(image, points[-1]))
        if face is not None and (mask > 127).any() and (index in rows or not kept):
            kept_rows.append(index)
            kept.append(downscaled_mask(mask))
    found = np.array([face_points is not None for face_points in points])
    if found.sum() < MINIMUM_FRAMES_WITH_FACE:
        raise InputError(
            f"expected a face in at least {MINIMUM_FRAMES_WITH_FACE} frames, found one in {found.sum()} of "
            f"{len(found)}; is the clip a portrait video?"
        )
    nearest = nearest_true_index(found)
    filled = np.stack([points[index] for index in nearest])
    clip = ClipLandmarks(filled, np.stack(scores)[nearest].astype(np.float64), found, size, fps)
    outline = OutlineDistances(np.stack(distances), distances[0].shape[1] / size[0])
    faces = [(float(face_points[:, 1].min()), float(face_points[:, 1].max())) for face_points in filled]
    motions = torso_image_motions(texture, outline, faces, fps)
    outline_masks = OutlineMasks(np.array(kept_rows), np.stack(kept), kept[0].shape[1] / size[0])
    return Observations(clip, motions, outline_masks, outline, SkinImages.stack(skin))
