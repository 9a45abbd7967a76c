"""Networks that segment a person: MediaPipe's selfie segmentation, and Robust Video Matting.

Networks are data here: TFLite through OpenCV, ONNX through onnxruntime. No format that can hold a program is read.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from ggavatar.errors import InputError
from ggavatar.io.regular_files import read_file

SELFIE_SIDE = 256
MAX_NETWORK_BYTES = 1 << 28
_EXTERNAL = b"\x0a\x08location\x12"
"""How ONNX (a protocol buffer) begins the name of another file that holds a tensor: the key `location`, then a text."""
_ADVICE = "--masks rvm uses RVM's own file, which ggavatar-models --fetch rvm gets"


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
            content = read_file(path, MAX_NETWORK_BYTES, "a network")
            self._network = cv2.dnn.readNetFromTFLite(np.frombuffer(content, np.uint8))
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


class RvmOnnx:
    """Robust Video Matting as ONNX through onnxruntime, which the user installs; recurrent over the images.

    An ONNX file is a list of operators and numbers and runs no code. RVM's TorchScript files are programs, which can
    write files, and are not read. Nor is OpenCV's DNN module used: 4.7.0-dev was reported to fail on RVM's ONNX files
    (PeterL1n/RobustVideoMatting, issue 215); later versions were not tried.

    Raises:
        InputError: onnxruntime is missing, or the file is not RVM's.
    """

    def __init__(self, path: Path) -> None:
        content = read_file(path, MAX_NETWORK_BYTES, "a network")
        if _EXTERNAL in content:
            raise InputError(f"{path}: expected a network in one file, found one that reads others; {_ADVICE}")
        try:
            import onnxruntime  # type: ignore[import-not-found]
        except ImportError as error:
            raise InputError(f"{path}: ONNX files need onnxruntime: pip install onnxruntime") from error
        options = onnxruntime.SessionOptions()
        options.log_severity_level = 4  # its warnings quote names from the file, a line for each
        try:
            self._session: Any = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
        except Exception as error:  # onnxruntime's exceptions share no base but Exception
            raise InputError(f"{path}: onnxruntime cannot load this file ({_first_line(error)}); {_ADVICE}") from error
        names = {item.name for item in self._session.get_inputs()}
        if not {"src", "r1i", "r2i", "r3i", "r4i", "downsample_ratio"} <= names:
            found = ", ".join(sorted(names))
            raise InputError(
                f"{path}: expected RVM's inputs src, r1i … r4i, downsample_ratio; found {found:.200}; {_ADVICE}"
            )
        self._path, self._state = path, [np.zeros((1, 1, 1, 1), np.float32)] * 4

    def coverage(self, image: UInt8[np.ndarray, "H W 3"]) -> Float[np.ndarray, "h w"]:
        """Alpha in [0, 1] at the image's resolution; call in frame order."""
        ratio = np.array([rvm_downsampling(*image.shape[:2])], np.float32)
        source = (image.astype(np.float32) / 255).transpose(2, 0, 1)[None]
        states = {f"r{index}i": state for index, state in enumerate(self._state, start=1)}
        try:
            outputs = self._session.run(None, {"src": source, "downsample_ratio": ratio, **states})
        except Exception as error:  # as above
            raise InputError(f"{self._path}: onnxruntime cannot run it ({_first_line(error)}); {_ADVICE}") from error
        if len(outputs) != 6 or np.shape(outputs[1]) != (1, 1, *image.shape[:2]):
            raise InputError(f"{self._path}: expected color, alpha and 4 states, found other outputs; {_ADVICE}")
        _, alpha, *self._state = outputs
        return alpha[0, 0]


def _first_line(error: Exception) -> str:
    return str(error).partition("\n")[0][:200]
