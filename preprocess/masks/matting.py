"""Soft foreground masks for a clip.

A network's coverage, average_over_time over time, reduced to the person and given a crisp edge.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from ggavatar.errors import InputError
from ggavatar.io.ordered_map import ordered_map
from preprocess.masks.cleanup import coverage_to_mask, keep_largest_component
from preprocess.masks.networks import MaskNetwork, RvmOnnx, RvmTorchScript, SelfieNetwork

EDGE_LEVEL, EDGE_GAIN = 0.57, 1.8
"""The network's coverage reaches a little too far.

Measured against a chroma key in docs/experiments/2026-11-22-mask-quality-and-frame-offsets.md.
"""

STILL_DIFFERENCE = 0.03
"""Difference between neighboring frames, in [0, 1].

Below which a pixel counts as still and its coverage is averaged over time.
"""

_CHANNEL_MEAN = np.full((1, 3), 1 / 3, np.float32)
"""Of three channels, as a matrix."""


@runtime_checkable
class Matting(Protocol):
    """A way to make masks for a whole clip."""

    @property
    def name(self) -> str:
        """For provenance."""
        ...

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the user should know about masks of this kind."""
        ...

    def masks(self, images: Iterable[np.ndarray]) -> Iterator[np.ndarray]:
        """8-bit masks of the clip's images, in order and of their size; a few images are held at a time."""
        ...


def open_matting(wanted: str, models: Path | None, offline: bool) -> Matting:
    """The matting for `--masks`: auto and selfie use the network, grabcut needs none, a file is the user's RVM.

    Raises:
        InputError: No such file, or a file that is no such network.
    """
    if wanted in ("auto", "selfie"):
        from ggavatar.pretrained.catalogue import resolve

        return SelfieMatting(SelfieNetwork(resolve("selfie_segmentation", models, offline)))
    if wanted == "grabcut":
        from preprocess.masks.grabcut import GrabCutMatting

        return GrabCutMatting()
    path = Path(wanted)
    if not path.is_file():
        raise InputError(f"--masks {wanted}: no such file or folder; expected one, or auto, selfie, grabcut")
    if path.suffix.lower() == ".onnx":
        return VideoMatting(RvmOnnx(path), f"rvm ({path.name})")
    return VideoMatting(RvmTorchScript(path), f"rvm ({path.name})")


@dataclass(frozen=True)
class VideoMatting:
    """A video network's own alpha, taken as it is."""

    network: MaskNetwork
    name: str
    warnings: tuple[str, ...] = ()

    def masks(self, images: Iterable[np.ndarray]) -> Iterator[np.ndarray]:
        """Alpha of each image, 8 bits."""
        for image in images:
            yield coverage_to_mask(self.network.coverage(image), image.shape[1], image.shape[0])


@dataclass(frozen=True)
class SelfieMatting:
    """Selfie segmentation of single images, made steady.

    Every second image is seen mirrored: averaged over time, that is as accurate as looking twice at each and costs
    half.
    """

    network: MaskNetwork
    name: str = "selfie"
    warnings: tuple[str, ...] = ()

    def masks(self, images: Iterable[np.ndarray]) -> Iterator[np.ndarray]:
        """Masks with one image of look-ahead; threads finish some while the network sees others."""
        return ordered_map(lambda three: _final_mask(*three), self._with_neighbors(images))

    def _with_neighbors(
        self, images: Iterable[np.ndarray]
    ) -> Iterator[tuple[_Observation | None, _Observation, _Observation | None]]:
        """Every image as it is seen, between the one before and the one after."""
        past: _Observation | None = None
        now: _Observation | None = None
        for index, image in enumerate(images):
            ahead = self._observe(image, mirrored=index % 2 == 1)
            if now is not None:
                yield past, now, ahead
            past, now = now, ahead
        if now is not None:
            yield past, now, None

    def _observe(self, image: np.ndarray, mirrored: bool) -> _Observation:
        coverage = self.network.coverage(cv2.flip(image, 1) if mirrored else image)
        coverage = cv2.flip(coverage, 1) if mirrored else coverage
        small = cv2.resize(image, coverage.shape[::-1], interpolation=cv2.INTER_AREA)
        return _Observation(coverage, small.astype(np.float32) / 255, image.shape[1], image.shape[0])


@dataclass(frozen=True)
class _Observation:
    """Coverage and look of one image at the network's resolution, and the image's size."""

    coverage: Float[np.ndarray, "h w"]
    look: Float[np.ndarray, "h w 3"]
    width: int
    height: int


def _final_mask(past: _Observation | None, now: _Observation, ahead: _Observation | None) -> UInt8[np.ndarray, "H W"]:
    """The mask of one image."""
    steady = average_over_time(now, [other for other in (past, ahead) if other is not None])
    wide = cv2.resize(steady, (now.width, now.height), interpolation=cv2.INTER_LINEAR)
    return keep_largest_component(coverage_to_mask((wide - EDGE_LEVEL) * EDGE_GAIN + 0.5, now.width, now.height))


def average_over_time(now: _Observation, others: list[_Observation]) -> Float[np.ndarray, "h w"]:
    """Coverage averaged with the neighboring images' where the picture stands still; where it moves, its own."""
    total, weight = now.coverage.copy(), np.ones_like(now.coverage)
    for other in others:
        difference = cv2.blur(cv2.transform(cv2.absdiff(other.look, now.look), _CHANNEL_MEAN), (3, 3))
        share = 0.5 * np.exp(-((difference / STILL_DIFFERENCE) ** 2)).astype(np.float32)
        total += share * other.coverage
        weight += share
    return total / weight
