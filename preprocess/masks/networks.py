"""Networks that segment a person: MediaPipe's selfie segmentation, and Robust Video Matting from the user's file."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from ggavatar.errors import InputError

SELFIE_SIDE = 256


@runtime_checkable
class MaskNetwork(Protocol):
    """A network that is given the images of a clip in order."""

    def coverage(self, image: UInt8[np.ndarray, "H W 3"]) -> Float[np.ndarray, "h w"]:
        """Foreground coverage in [0, 1], at the network's own resolution."""
        ...


class SelfieNetwork:
    """MediaPipe selfie segmentation through OpenCV's DNN module, at 256 × 256 px.

    Raises:
        InputError: OpenCV cannot load the file.
    """

    def __init__(self, path: Path) -> None:
        try:
            self._network = cv2.dnn.readNetFromTFLite(str(path))
        except cv2.error as error:
            raise InputError(f"{path}: OpenCV cannot load this network ({error.err}); download it again") from error

    def coverage(self, image: UInt8[np.ndarray, "H W 3"]) -> Float[np.ndarray, "h w"]:
        """Foreground coverage in [0, 1], 256 × 256."""
        small = cv2.resize(image, (SELFIE_SIDE, SELFIE_SIDE), interpolation=cv2.INTER_AREA)
        self._network.setInput(cv2.dnn.blobFromImage(small, 1 / 255))
        return np.clip(self._network.forward().reshape(SELFIE_SIDE, SELFIE_SIDE), 0, 1).astype(np.float32)


def rvm_downsampling(height: int, width: int) -> float:
    """RVM's downsampling ratio: its network works on at most 512 px."""
    return min(512 / max(height, width), 1.0)


class RvmTorchScript:
    """Robust Video Matting as TorchScript (the user's file; GPL-3.0, not distributed); recurrent over the images.

    Raises:
        InputError: Not a TorchScript file, or not RVM's.
    """

    def __init__(self, path: Path) -> None:
        import torch

        self._torch = torch
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # newer torch deprecates TorchScript, in which RVM is published
                self._module = torch.jit.load(str(path), map_location="cpu").eval()
        except (RuntimeError, ValueError) as error:
            raise InputError(
                f"{path}: not a TorchScript file ({str(error).splitlines()[0]}); use rvm_mobilenetv3_fp32.torchscript"
            ) from error
        self._path, self._state = path, [None, None, None, None]

    def coverage(self, image: UInt8[np.ndarray, "H W 3"]) -> Float[np.ndarray, "h w"]:
        """Alpha in [0, 1] at the image's resolution; call in frame order."""
        source = self._torch.from_numpy(image).permute(2, 0, 1)[None].float() / 255
        try:
            with self._torch.no_grad():
                _, alpha, *self._state = self._module(source, *self._state, rvm_downsampling(*image.shape[:2]))
        except (RuntimeError, TypeError, ValueError) as error:
            raise InputError(
                f"{self._path}: expected RVM's interface (image, 4 states, ratio → color, alpha, 4 states); use "
                "rvm_mobilenetv3_fp32.torchscript"
            ) from error
        return alpha[0, 0].numpy()


class RvmOnnx:
    """Robust Video Matting as ONNX through onnxruntime, which the user installs; recurrent over the images.

    Raises:
        InputError: onnxruntime is missing, or the file is not RVM's.
    """

    def __init__(self, path: Path) -> None:
        try:
            import onnxruntime  # type: ignore[import-not-found]
        except ImportError as error:
            raise InputError(
                f"{path}: ONNX files need onnxruntime; pip install onnxruntime, or use RVM's .torchscript file"
            ) from error
        try:
            self._session: Any = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
        except Exception as error:  # onnxruntime's exceptions share no base but Exception
            raise InputError(f"{path}: onnxruntime cannot load this file ({str(error).splitlines()[0]})") from error
        names = {item.name for item in self._session.get_inputs()}
        if not {"src", "r1i", "r2i", "r3i", "r4i", "downsample_ratio"} <= names:
            raise InputError(
                f"{path}: expected RVM's inputs src, r1i … r4i, downsample_ratio; found {', '.join(sorted(names))}"
            )
        self._state = [np.zeros((1, 1, 1, 1), np.float32)] * 4

    def coverage(self, image: UInt8[np.ndarray, "H W 3"]) -> Float[np.ndarray, "h w"]:
        """Alpha in [0, 1] at the image's resolution; call in frame order."""
        ratio = np.array([rvm_downsampling(*image.shape[:2])], np.float32)
        source = (image.astype(np.float32) / 255).transpose(2, 0, 1)[None]
        states = {f"r{index}i": state for index, state in enumerate(self._state, start=1)}
        _, alpha, *self._state = self._session.run(None, {"src": source, "downsample_ratio": ratio, **states})
        return alpha[0, 0]
