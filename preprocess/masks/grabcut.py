"""Masks without a network: GrabCut initialized with a guess of head and shoulders. A fallback, and it says so."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import cv2
import cv2.data
import numpy as np
from jaxtyping import UInt8

from ggavatar.errors import InputError
from preprocess.masks.cleanup import keep_largest_component

SIDE = 256
BAND = 8
"""How far the outline may move from one frame to the next, px at 256 × 256."""


class GrabCutMatting:
    """Color models of person and background, carried from frame to frame."""

    name = "grabcut"
    warnings: tuple[str, ...] = (
        "GrabCut masks are a fallback: they lose gray clothes on gray walls and keep furniture behind the person. "
        "Check preview.jpg, or use --masks selfie or a folder of masks",
    )

    def masks(self, images: Iterable[np.ndarray]) -> Iterator[np.ndarray]:
        """The mask of every image.

        Raises:
            InputError: No face in the first image.
        """
        labels: np.ndarray | None = None
        for image in images:
            small = cv2.resize(image, (SIDE, SIDE), interpolation=cv2.INTER_AREA)
            start = _initial_labels(small) if labels is None else _labels_around(labels)
            labels = _run_grabcut(small, start, iterations=3 if labels is None else 1)
            soft = cv2.GaussianBlur(labels.astype(np.float32), (0, 0), 1.0)
            mask = cv2.resize(soft, (image.shape[1], image.shape[0]), interpolation=cv2.INTER_LINEAR)
            yield keep_largest_component(np.round(np.clip(mask, 0, 1) * 255).astype(np.uint8))


def _run_grabcut(
    small: UInt8[np.ndarray, "h w 3"], labels: UInt8[np.ndarray, "h w"], iterations: int
) -> UInt8[np.ndarray, "h w"]:
    """1 for the person, 0 elsewhere; OpenCV's generator is seeded, so a clip always gets the same masks."""
    cv2.setRNGSeed(0)
    background, person = np.zeros((1, 65)), np.zeros((1, 65))
    cv2.grabCut(
        np.ascontiguousarray(small[..., ::-1]), labels, None, background, person, iterations, cv2.GC_INIT_WITH_MASK
    )
    return ((labels == cv2.GC_FGD) | (labels == cv2.GC_PR_FGD)).astype(np.uint8)


def _initial_labels(small: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w"]:
    """Labels: definite background, probable person (an ellipse and a trapezoid below the face), definite face."""
    cascade = cv2.CascadeClassifier(cv2.data.haarcascades + "haarcascade_frontalface_default.xml")
    faces = cascade.detectMultiScale(cv2.cvtColor(small, cv2.COLOR_RGB2GRAY), 1.1, 4, minSize=(24, 24))
    if not len(faces):
        raise InputError("--masks grabcut: no face found in the first frame; use --masks selfie or a folder of masks")
    x, y, width, height = max(faces, key=lambda face: face[2] * face[3])
    center = (int(x + width / 2), int(y + height / 2))
    labels = np.full((SIDE, SIDE), cv2.GC_BGD, np.uint8)
    cv2.ellipse(labels, center, (int(1.1 * width), int(1.3 * height)), 0, 0, 360, int(cv2.GC_PR_BGD), -1)
    bottom = int(y + 1.25 * height)
    shoulders = [(center[0] - width // 2, bottom - height // 4), (center[0] + width // 2, bottom - height // 4)]
    shoulders += [(center[0] + 2 * width, SIDE - 1), (center[0] - 2 * width, SIDE - 1)]
    cv2.fillPoly(labels, [np.array(shoulders, np.int32)], int(cv2.GC_PR_FGD))
    cv2.ellipse(labels, center, (int(0.7 * width), int(0.9 * height)), 0, 0, 360, int(cv2.GC_PR_FGD), -1)
    cv2.ellipse(labels, center, (int(0.4 * width), int(0.5 * height)), 0, 0, 360, int(cv2.GC_FGD), -1)
    return labels


def _labels_around(person: UInt8[np.ndarray, "h w"]) -> UInt8[np.ndarray, "h w"]:
    """GrabCut labels that leave only a band around the last outline undecided."""
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * BAND + 1, 2 * BAND + 1))
    labels = np.where(person > 0, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    labels[cv2.erode(person, disc) > 0] = cv2.GC_FGD
    labels[cv2.dilate(person, disc) == 0] = cv2.GC_BGD
    return labels
