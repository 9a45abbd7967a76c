"""A driving sequence: the head parameters and cameras that drive an avatar, as plain numpy arrays."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ggavatar.data.capture import Capture
from ggavatar.errors import InputError
from ggavatar.formats.arkit_recording import (
    ARKIT_NAMES,
    DEFAULT_FPS,
    ArkitRecording,
    is_arkit_recording,
    read_arkit_recording,
)
from ggavatar.formats.flame_parameters import FlameParameters, read_flame_parameters
from ggavatar.head.expression_axes import names_without_file
from ggavatar.head.flame import JOINT_NAMES
from ggavatar.io.npz import npz_headers, read_npz
from ggavatar.landmarks.blendshapes import NAMES
from ggavatar.training.run_folder import Run

FILE_FPS = 25.0
"""Frame rate of files that do not say theirs, frames per second."""


@dataclass(frozen=True)
class Cameras:
    """Cameras of T frames.

    Attributes:
        world_to_camera: Rigid, OpenCV axes, m.
        intrinsics: Camera matrices for images of `size`, px.
        size: Width and height of the images, px.
    """

    world_to_camera: Float[np.ndarray, "T 4 4"]
    intrinsics: Float[np.ndarray, "T 3 3"]
    size: tuple[int, int]

    def rows(self, chosen: np.ndarray | slice) -> Cameras:
        """The cameras of some frames."""
        return Cameras(self.world_to_camera[chosen], self.intrinsics[chosen], self.size)

    def view_width(self) -> float:
        """Width of the first frame's field of view at the distance of the head, m."""
        depth = max(abs(float(self.world_to_camera[0, 2, 3])), 1e-6)
        return depth * self.size[0] / float(self.intrinsics[0, 0, 0])


@dataclass(frozen=True)
class DrivingSequence:
    """T frames of head parameters and, if known, cameras.

    Attributes:
        expression: Coefficients of the basis named by `head_version`.
        joint_rotations: Axis-angle in the order of `joint_names`, rad.
        eyelids: Closure of the left and right eyelid, 0 open.
        translation: Translation of the posed head, m.
        cameras: None if the source has none.
        frames: Source frame numbers.
        fps: Frames per second of the source.
        joint_names: Names as in the head model.
        head_version: Version tag of the parameter space.
        axis_names: What each coefficient means, as in the head model; empty if unknown.
        scores: ARKit's expression scores of the frames in the order of `ggavatar.landmarks.blendshapes.NAMES`, NaN in
            frames without a face; None if they were not measured.
    """

    expression: Float[np.ndarray, "T E"]
    joint_rotations: Float[np.ndarray, "T J 3"]
    eyelids: Float[np.ndarray, "T 2"]
    translation: Float[np.ndarray, "T 3"]
    cameras: Cameras | None
    frames: tuple[int, ...]
    fps: float
    joint_names: tuple[str, ...]
    head_version: str
    axis_names: tuple[str, ...] = ()
    scores: Float[np.ndarray, "T 52"] | None = None

    def rows(self, chosen: np.ndarray | slice) -> DrivingSequence:
        """The sequence restricted to some frames."""
        return dataclasses.replace(
            self,
            expression=self.expression[chosen],
            joint_rotations=self.joint_rotations[chosen],
            eyelids=self.eyelids[chosen],
            translation=self.translation[chosen],
            cameras=self.cameras and self.cameras.rows(chosen),
            frames=tuple(np.array(self.frames)[chosen].tolist()),
            scores=None if self.scores is None else self.scores[chosen],
        )

    def row(self, frame: int) -> int:
        """Row of a source frame number; `InputError` if there is no such frame."""
        if frame not in self.frames:
            raise InputError(f"expected a frame from {self.frames[0]} to {self.frames[-1]}, found no frame {frame}")
        return self.frames.index(frame)


def driving_sequence_of(capture: Capture) -> DrivingSequence:
    """The tracking of a capture as a driving sequence."""
    names = _head_names(capture)
    return _tracked(capture, names["joint_names"], names["expression_names"])


def driving_sequence_of_run(run: Run) -> DrivingSequence:
    """The tracking that the avatar of a run was trained and tested on, as a driving sequence."""
    names = run.head.expression_names or names_without_file(run.head.version, run.head.expression_basis.shape[2])
    return _tracked(run.capture, run.head.joint_names, names)


def _tracked(capture: Capture, joint_names: tuple[str, ...], axis_names: tuple[str, ...]) -> DrivingSequence:
    tracking = capture.tracking
    return DrivingSequence(
        expression=tracking.expression.astype(np.float64),
        joint_rotations=tracking.joint_rotations.astype(np.float64),
        eyelids=tracking.eyelids.astype(np.float64),
        translation=tracking.translation.astype(np.float64),
        cameras=Cameras(
            tracking.world_to_camera.astype(np.float64),
            tracking.intrinsics.astype(np.float64),
            (capture.width, capture.height),
        ),
        frames=capture.frames,
        fps=capture.fps,
        joint_names=joint_names,
        head_version=capture.head_version,
        axis_names=axis_names,
    )


def _head_names(capture: Capture) -> dict[str, tuple[str, ...]]:
    """Names of joints and expression axes, read without the rest of the head."""
    present = [key for key in ("joint_names", "expression_names") if key in npz_headers(capture.head_path)]
    found = {key: tuple(str(name) for name in value) for key, value in read_npz(capture.head_path, present).items()}
    older = names_without_file(capture.head_version, capture.tracking.expression.shape[1])
    return {"expression_names": older, **found}


def driving_sequence_of_scores(recording: ArkitRecording) -> DrivingSequence:
    """A recording of ARKit's scores: a face without a head, whose pose stays that of the avatar at rest."""
    recording = recording.resampled(DEFAULT_FPS)
    count = len(recording.times)
    scores = np.zeros((count, len(NAMES)))
    for column, name in enumerate(NAMES):
        if name in ARKIT_NAMES:
            scores[:, column] = recording.scores[:, ARKIT_NAMES.index(name)]
    return DrivingSequence(
        expression=np.zeros((count, 0)),
        joint_rotations=np.zeros((count, 0, 3)),
        eyelids=np.zeros((count, 2)),
        translation=np.zeros((count, 3)),
        cameras=None,
        frames=tuple(range(count)),
        fps=DEFAULT_FPS,
        joint_names=(),
        head_version="arkit",
        scores=scores,
    )


def read_driving_sequence(path: Path) -> DrivingSequence:
    """Read a driving sequence (docs/driving.md): a capture folder, an .npz file, or a recording of ARKit's scores.

    Raises:
        InputError: None of these, or an array is missing, has the wrong shape or is not finite.
    """
    if path.is_dir():
        return driving_sequence_of(Capture.open(path))
    if is_arkit_recording(path):
        return driving_sequence_of_scores(read_arkit_recording(path))
    if path.suffix.lower() != ".npz":
        raise InputError(
            f"{path}: expected a capture folder, an .npz file of head parameters, or a recording of ARKit's or "
            "MediaPipe's scores (CSV, JSON, npz) with names; see docs/driving.md"
        )
    if "expr" in npz_headers(path):
        return _driving_sequence_of_flame(read_flame_parameters(path))
    arrays = read_npz(path)
    count = len(_array(path, arrays, "expression", (None, None)))
    names = tuple(str(name) for name in np.atleast_1d(arrays.get("joint_names", np.array([], str))))
    if "version" not in arrays:
        raise InputError(
            f"{path}: expected the array 'version' with the head's version tag, such as flame2020, found none"
        )
    if "joint_rotations" in arrays and not names:
        raise InputError(
            f"{path}: expected 'joint_names' with 'joint_rotations', found none; add the names, root first"
        )
    expression = _array(path, arrays, "expression", (None, None))
    return DrivingSequence(
        expression=expression,
        joint_rotations=_array(path, arrays, "joint_rotations", (count, len(names), 3)),
        eyelids=_array(path, arrays, "eyelids", (count, 2)),
        translation=_array(path, arrays, "translation", (count, 3)),
        cameras=_cameras(path, arrays, count),
        frames=_frame_numbers(path, arrays, count),
        fps=_frames_per_second(path, arrays),
        joint_names=names,
        head_version=str(arrays["version"]),
        axis_names=names_without_file(str(arrays["version"]), expression.shape[1]),
    )


def _driving_sequence_of_flame(parameters: FlameParameters) -> DrivingSequence:
    """GaussianAvatars' or VHAP's flame_param.npz, which does not say which version of FLAME it is for."""
    count = len(parameters)
    return DrivingSequence(
        expression=parameters.expression.astype(np.float64),
        joint_rotations=parameters.joint_rotations.astype(np.float64),
        eyelids=np.zeros((count, 2)),
        translation=parameters.translation.astype(np.float64),
        cameras=None,
        frames=tuple(range(count)),
        fps=FILE_FPS,
        joint_names=JOINT_NAMES,
        head_version="flame",
    )


def _cameras(path: Path, arrays: dict[str, np.ndarray], count: int) -> Cameras | None:
    """Cameras, if all three arrays are present."""
    present = [name for name in ("world_to_camera", "intrinsics", "size") if name in arrays]
    if not present:
        return None
    if len(present) < 3:
        raise InputError(f"{path}: expected world_to_camera, intrinsics and size together, found {', '.join(present)}")
    width, height = _array(path, arrays, "size", (2,))
    view = _array(path, arrays, "world_to_camera", (count, 4, 4))
    return Cameras(view, _array(path, arrays, "intrinsics", (count, 3, 3)), (int(width), int(height)))


def _frames_per_second(path: Path, arrays: dict[str, np.ndarray]) -> float:
    fps = float(_array(path, arrays, "fps", ())) if "fps" in arrays else FILE_FPS
    if not 1 <= fps <= 1000:
        raise InputError(f"{path}: expected 1 to 1000 frames per second in 'fps', found {fps:g}")
    return fps


def _array(path: Path, arrays: dict[str, np.ndarray], name: str, shape: tuple[int | None, ...]) -> np.ndarray:
    """A validated array; an optional one that is missing becomes zeros (neutral)."""
    if name not in arrays:
        if None in shape:
            found = ", ".join(sorted(arrays))[:200] or "none at all"
            raise InputError(f"{path}: expected the array {name!r}, found {found}")
        return np.zeros([size or 0 for size in shape])
    array = arrays[name]
    wanted = "×".join("any" if size is None else str(size) for size in shape)
    fits = [size in (None, found) for size, found in zip(shape, array.shape, strict=False)]
    if array.ndim != len(shape) or not all(fits) or 0 in array.shape[:1]:
        raise InputError(f"{path}: expected {name!r} of shape {wanted}, found {'×'.join(map(str, array.shape))}")
    if array.dtype.kind not in "fiu" or not np.isfinite(array).all():
        raise InputError(f"{path}: expected finite numbers in {name!r}, found {array.dtype} with NaN, infinity or text")
    return array.astype(np.float64)


def _frame_numbers(path: Path, arrays: dict[str, np.ndarray], count: int) -> tuple[int, ...]:
    frames = [int(number) for number in np.atleast_1d(arrays.get("frames", np.arange(count)))]
    if len(frames) != count or sorted(set(frames)) != frames:
        raise InputError(f"{path}: expected {count} ascending frame numbers in 'frames', found {len(frames)}")
    return tuple(frames)
