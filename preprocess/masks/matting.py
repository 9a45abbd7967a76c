"""Soft foreground masks for a clip: network coverage, smoothed over time, reduced to one person, edges sharpened."""

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
from preprocess.masks.networks import MaskNetwork, RvmOnnx, SelfieNetwork

EDGE_LEVEL, EDGE_GAIN = 0.57, 1.8
"""Coverage level that becomes 0.5, and contrast around it: the network's coverage extends slightly too far.

Measured against a chroma key in docs/experiments/2026-11-22-mask-quality-and-frame-offsets.md.
"""

STILL_DIFFERENCE = 0.03
"""Difference between neighboring frames, in [0, 1], below which a pixel's coverage is averaged over time."""

_CHANNEL_MEAN = np.full((1, 3), 1 / 3, np.float32)
"""Mean of three channels as a matrix."""


@runtime_checkable
class Matting(Protocol):
    """A method that makes masks for a whole clip."""

    @property
    def name(self) -> str:
        """Name in the capture's provenance."""
        ...

    @property
    def warnings(self) -> tuple[str, ...]:
        """Known weaknesses of these masks, for the user."""
        ...

    def masks(self, images: Iterable[np.ndarray]) -> Iterator[np.ndarray]:
        """8-bit masks of the clip's images, in order and of the same size; only a few images are held at a time."""
        ...


def open_matting(wanted: str, models: Path | None, offline: bool) -> Matting:
    """The matting method for `--masks`: MediaPipe's network, GrabCut, or RVM, of the catalogue or the user's file.

    Raises:
        InputError: No such file, not an RVM network, or a TorchScript file, which is a program.
    """
    from ggavatar.pretrained.resolve import resolve

    if wanted in ("auto", "selfie"):
        return SelfieMatting(SelfieNetwork(resolve("selfie_segmentation", models, offline)))
    if wanted == "grabcut":
        from preprocess.masks.grabcut import GrabCutMatting

        return GrabCutMatting()
    if wanted == "rvm":
        return VideoMatting(RvmOnnx(resolve("rvm", models, offline)), "rvm")
    path = Path(wanted)
    if not path.exists():
        raise InputError(f"--masks {wanted}: no such file or folder; expected one, or auto, selfie, rvm, grabcut")
    if path.suffix.lower() != ".onnx":
        raise InputError(
            f"--masks {wanted}: expected an RVM network as .onnx. TorchScript and PyTorch files (.torchscript, .pt, "
            ".pth) are programs and are not read; --masks rvm uses the same network, which ggavatar-models --fetch rvm "
            "gets, with onnxruntime (pip install onnxruntime)"
        )
    return VideoMatting(RvmOnnx(path), f"rvm ({path.name})")


@dataclass(frozen=True)
class VideoMatting:
    """A video matting network's alpha, unchanged."""

    network: MaskNetwork
    name: str
    warnings: tuple[str, ...] = ()

    def masks(self, images: Iterable[np.ndarray]) -> Iterator[np.ndarray]:
        """The alpha of every image as an 8-bit mask."""
        for image in images:
            yield coverage_to_mask(self.network.coverage(image), image.shape[1], image.shape[0])


@dataclass(frozen=True)
class SelfieMatting:
    """Selfie segmentation of single images, smoothed over time.

    Every second image is mirrored for the network: averaged over time, that is as accurate as running the network on
    each image and its mirror image, at half the cost.
    """

    network: MaskNetwork
    name: str = "selfie"
    warnings: tuple[str, ...] = ()

    def masks(self, images: Iterable[np.ndarray]) -> Iterator[np.ndarray]:
        """Masks with one image of look-ahead; threads post-process some while the network works on others."""
        return ordered_map(lambda three: _final_mask(*three), self._with_neighbors(images))

    def _with_neighbors(
        self, images: Iterable[np.ndarray]
    ) -> Iterator[tuple[_Observation | None, _Observation, _Observation | None]]:
        """Every observation with the one before and the one after."""
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
    """Coverage and colors of one image at the network's resolution, and the image's size in px."""

    coverage: Float[np.ndarray, "h w"]
    colors: Float[np.ndarray, "h w 3"]
    width: int
    height: int


def _final_mask(past: _Observation | None, now: _Observation, ahead: _Observation | None) -> UInt8[np.ndarray, "H W"]:
    """The mask of one image."""
    smooth = average_over_time(now, [other for other in (past, ahead) if other is not None])
    large = cv2.resize(smooth, (now.width, now.height), interpolation=cv2.INTER_LINEAR)
    return keep_largest_component(coverage_to_mask((large - EDGE_LEVEL) * EDGE_GAIN + 0.5, now.width, now.height))


def average_over_time(now: _Observation, others: list[_Observation]) -> Float[np.ndarray, "h w"]:
    """Coverage averaged with the neighboring images' where nothing moves, and the image's own where something does."""
    total, weight = now.coverage.copy(), np.ones_like(now.coverage)
    for other in others:
        difference = cv2.blur(cv2.transform(cv2.absdiff(other.colors, now.colors), _CHANNEL_MEAN), (3, 3))
        similarity = 0.5 * np.exp(-((difference / STILL_DIFFERENCE) ** 2)).astype(np.float32)
        total += similarity * other.coverage
        weight += similarity
    return total / weight
