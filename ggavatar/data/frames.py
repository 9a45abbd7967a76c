"""Frames of a capture for training and evaluation: composited, resized, on the device, read ahead of use."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Generator, Iterable, Iterator, Sequence

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from ggavatar.core import Camera, Drive, Frame
from ggavatar.data.capture import Capture
from ggavatar.geometry.transforms import axis_angle_to_matrix, rigid
from ggavatar.head.model import HeadModel
from ggavatar.io.ordered_map import ordered_map
from ggavatar.optim.seeding import seeded

AHEAD = 4
"""Frames read ahead of the one in use."""
READERS = 4
"""Threads that decode frames for a CUDA device; for a CPU there is one, which leaves the cores to the training."""
DEVICE_SHARE = 4
"""A CUDA device keeps frames in one part in so many of the memory that is free when the training starts."""


class Frames:
    """The frames of a capture, read on demand and cached as 8-bit pixels within a memory budget.

    A CUDA device keeps the frames that it has been given, as 8-bit pixels within a budget of its own; the others are
    copied to it from pinned memory, decoded by several threads ahead of use. Cached frames are not evicted: training
    visits frames in random order, so replacing one by another gains nothing.
    """

    def __init__(
        self,
        capture: Capture,
        head: HeadModel,
        background: Float[Tensor, "3"],
        device: torch.device | str,
        budget_mib: int = 512,
    ) -> None:
        """Prepare drives and cameras of all frames; no image is read yet.

        Args:
            capture: The capture that holds the frames.
            head: The capture's head model.
            background: Color behind the person, sRGB in [0, 1].
            device: Device of the tensors.
            budget_mib: Memory for cached pixels, MiB; 0 caches none.
        """
        self._capture, self._device = capture, device
        self.background = background.detach().cpu().to(torch.float32)
        self._drives, self._cameras = drives_and_cameras(capture, head, device)
        self._lock = threading.Lock()
        self._room = budget_mib << 20
        self._on_device = DeviceFrames(torch.device(device)) if torch.device(device).type == "cuda" else None
        self._kept: dict[tuple[int, int, int], tuple[np.ndarray, np.ndarray]] = {}

    def drive(self, number: int) -> Drive:
        """The drive of a source frame."""
        return self._drives[self._capture.row(number)]

    def camera(self, number: int) -> Camera:
        """The camera of a source frame, at the capture's size."""
        return self._cameras[self._capture.row(number)]

    def frame(self, number: int, width: int | None = None, height: int | None = None, keep: bool = False) -> Frame:
        """One frame, at the capture's size or resampled by area averaging.

        Args:
            number: Source frame number.
            width: Width to resample to, px; None is the capture's.
            height: Height to resample to, px; None is the capture's.
            keep: Cache the pixels if the memory budget allows.

        Raises:
            InputError: The image or mask is missing or damaged.
        """
        size = (width or self._capture.width, height or self._capture.height)
        image, alpha = self._pixels(number, *size, keep)
        return Frame(
            drive=self.drive(number),
            camera=self.camera(number).resized(*size),
            image=_to_float(image, self._device),
            alpha=_to_float(alpha[..., None], self._device),
        )

    def stream(self, requests: Iterable[tuple[int, int, int]]) -> Generator[Frame]:
        """Frames for (number, width, height) in order, read and cached by threads, `AHEAD` frames ahead."""
        if self._on_device is None:
            return ordered_map(lambda request: self.frame(*request, keep=True), requests, threads=1, ahead=AHEAD)
        return self._device_stream(self._on_device, requests)

    def _device_stream(self, kept: DeviceFrames, requests: Iterable[tuple[int, int, int]]) -> Generator[Frame]:
        """The same for a CUDA device: threads decode what it does not hold yet, and the caller's thread copies."""

        def read(request: tuple[int, int, int]) -> tuple[tuple[int, int, int], Tensor | None]:
            if request in kept:
                return request, None
            image, alpha = self._pixels(*request, keep=not kept.has_room_for(*request[1:]))
            return request, torch.from_numpy(np.concatenate((image, alpha[..., None]), axis=-1)).pin_memory()

        with contextlib.closing(ordered_map(read, requests, threads=READERS, ahead=AHEAD)) as pixels:
            for request, found in pixels:
                values = kept.take(request, found)
                number, *size = request
                camera = self._camera_at(number, *size)
                yield Frame(self.drive(number), camera, _unit(values[..., :3]), _unit(values[..., 3:]))

    def _camera_at(self, number: int, width: int, height: int) -> Camera:
        return self.camera(number).resized(width, height)

    def _pixels(self, number: int, width: int, height: int, keep: bool) -> tuple[np.ndarray, np.ndarray]:
        """Composited colors [H, W, 3] and coverage [H, W], 8-bit, from the cache or from disk."""
        key = (number, width, height)
        found = self._kept.get(key)
        if found is None:
            found = self._read(number, width, height)
            if keep:
                self._keep(key, found)
        return found

    def _keep(self, key: tuple[int, int, int], pixels: tuple[np.ndarray, np.ndarray]) -> None:
        """Cache the pixels if the budget allows."""
        size = sum(part.nbytes for part in pixels)
        with self._lock:
            if size > self._room:
                self._forget_other_sizes(*key[1:])
            if size <= self._room and key not in self._kept:
                self._room -= size
                self._kept[key] = pixels

    def _forget_other_sizes(self, width: int, height: int) -> None:
        """Drop frames of other sizes; training never returns to an earlier resolution."""
        for key in [key for key in list(self._kept) if key[1:] != (width, height)]:
            self._room += sum(part.nbytes for part in self._kept.pop(key))

    def _read(self, number: int, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
        alpha = self._capture.mask(number).astype(np.float32)
        coverage = alpha[..., None] / 255
        image = self._capture.image(number) * coverage + self.background.numpy() * 255 * (1 - coverage)
        if (width, height) != (self._capture.width, self._capture.height):
            import cv2

            image, alpha = (cv2.resize(part, (width, height), interpolation=cv2.INTER_AREA) for part in (image, alpha))
        return np.rint(image).astype(np.uint8), np.rint(alpha).astype(np.uint8)


class DeviceFrames:
    """Frames on a CUDA device, as 8-bit colors and coverage [H, W, 4], up to a share of its free memory."""

    def __init__(self, device: torch.device) -> None:
        self._device = device
        self._room = torch.cuda.mem_get_info(device)[0] // DEVICE_SHARE
        self._kept: dict[tuple[int, int, int], Tensor] = {}

    def __contains__(self, request: tuple[int, int, int]) -> bool:
        return request in self._kept

    def has_room_for(self, width: int, height: int) -> bool:
        """Whether one more frame of this size fits, if need be in place of frames of other sizes."""
        others = sum(value.numel() for key, value in list(self._kept.items()) if key[1:] != (width, height))
        return 4 * width * height <= self._room + others

    def take(self, request: tuple[int, int, int], pixels: Tensor | None) -> Tensor:
        """The pixels of a request on the device: those it holds, or `pixels`, copied from pinned memory and kept.

        Training never returns to an earlier resolution: frames of other sizes go first.
        """
        found = self._kept.get(request)
        if found is not None:
            return found
        assert pixels is not None, "only frames that the device holds come without pixels"
        found = pixels.to(self._device, non_blocking=True)
        if found.numel() > self._room:
            for key in [key for key in self._kept if key[1:] != request[1:]]:
                self._room += self._kept.pop(key).numel()
        if found.numel() <= self._room:
            self._room -= found.numel()
            self._kept[request] = found
        return found


def random_order(numbers: Sequence[int], seed: int, first_step: int) -> Iterator[int]:
    """An endless sequence of frames: a new permutation of `numbers` each epoch, starting at step `first_step` (from 1).

    It depends on seed and step only.
    """
    count = len(numbers)
    epoch, offset = divmod(first_step - 1, count)
    while True:
        order = torch.randperm(count, generator=seeded(seed, 1, epoch)).tolist()
        yield from (numbers[index] for index in order[offset:])
        epoch, offset = epoch + 1, 0


def drives_and_cameras(
    capture: Capture, head: HeadModel, device: torch.device | str
) -> tuple[list[Drive], list[Camera]]:
    """Drives and cameras of all frames of a capture at its full size, on a device."""
    tracking = capture.tracking

    def tensor(values: np.ndarray) -> Tensor:
        return torch.as_tensor(np.ascontiguousarray(values), dtype=torch.float32).to(device)

    columns = [
        tensor(values)
        for values in (tracking.expression, tracking.joint_rotations, tracking.eyelids, tracking.translation)
    ]
    intrinsics, views = tensor(tracking.intrinsics), tensor(tracking.world_to_camera)
    torso = None if tracking.torso_to_camera is None else tensor(tracking.torso_to_camera)
    drives, cameras = [], []
    for row, number in enumerate(capture.frames):
        expression, joints, eyelids, translation = (column[row] for column in columns)
        pose = views[row] @ head_pose(head, joints, translation)
        torso_pose = None if torso is None else torso[row]
        drives.append(Drive(expression, joints, eyelids, translation, pose, number, torso_pose))
        cameras.append(Camera(intrinsics[row], views[row], capture.width, capture.height))
    return drives, cameras


def head_pose(
    head: HeadModel, joint_rotations: Float[Tensor, "J 3"], translation: Float[Tensor, "3"]
) -> Float[Tensor, "4 4"]:
    """Rigid transform of the skull in the world: root, then neck, then translation.

    It is the identity for trackers that move the camera instead of the head.
    """
    chain = [index for index, name in enumerate(head.joint_names) if name in ("root", "neck")]
    rotations = axis_angle_to_matrix(joint_rotations)
    joints = head.joint_regressor @ head.template
    motion = rigid(torch.eye(3, dtype=joints.dtype, device=joints.device), torch.zeros_like(translation))
    for index in chain:
        motion = motion @ rigid(rotations[index], joints[index] - rotations[index] @ joints[index])
    return rigid(motion[:3, :3], motion[:3, 3] + translation)


def evenly_spaced(numbers: Sequence[int], count: int) -> list[int]:
    """At most `count` of `numbers`, evenly spaced, including the first and the last."""
    if count >= len(numbers):
        return list(numbers)
    picks = np.linspace(0, len(numbers) - 1, count).round().astype(int)
    return [numbers[index] for index in dict.fromkeys(picks.tolist())]


def _to_float(pixels: np.ndarray, device: torch.device | str) -> Tensor:
    return _unit(torch.from_numpy(pixels).to(device))


def _unit(pixels: Tensor) -> Tensor:
    """8-bit values in [0, 1]."""
    return pixels / 255
