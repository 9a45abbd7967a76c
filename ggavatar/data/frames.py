"""Frames of a capture for training and evaluation: composited, resized, on the device, read ahead of use."""

from __future__ import annotations

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


class Frames:
    """The frames of a capture, read on demand and cached as 8-bit pixels within a memory budget.

    Cached frames are not evicted: training visits frames in random order, so replacing one by another gains nothing.
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
        self._room = budget_mib << 20
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
        """Frames for (number, width, height) in order; one thread reads and caches them, `AHEAD` frames ahead."""
        return ordered_map(lambda request: self.frame(*request, keep=True), requests, threads=1, ahead=AHEAD)

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
        """Cache the pixels if the budget allows; called by the reader thread only."""
        size = sum(part.nbytes for part in pixels)
        if size > self._room:
            self._forget_other_sizes(*key[1:])
        if size <= self._room:
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
    return torch.from_numpy(pixels).to(device).to(torch.float32) / 255
