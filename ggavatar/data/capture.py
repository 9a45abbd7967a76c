"""A capture: the folder that holds all data for training and evaluation (docs/capture-format.md).

Pixels are read on demand. This module does not import torch.
"""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from ggavatar.data.capture_schema import (
    check_head,
    check_images,
    check_tracking,
    read_description,
    read_tracking,
    with_remedy,
    write_description,
)
from ggavatar.data.splits import Split
from ggavatar.errors import InputError
from ggavatar.io.digests import sha256_of
from ggavatar.io.images import read_gray, read_rgb, write_png
from ggavatar.io.npz import write_npz
from ggavatar.text.names import clean_name

DESCRIPTION, TRACKING, HEAD, IMAGES, MASKS = "capture.json", "tracking.npz", "head.npz", "images", "masks"


@dataclass(frozen=True)
class Tracking:
    """Cameras and head parameters of T frames, one row per frame.

    Attributes:
        intrinsics: Focal lengths and principal point, px of the capture's images.
        world_to_camera: Rigid transforms, m, OpenCV axes.
        expression: Coefficients of the head's expression basis.
        joint_rotations: Axis-angle in the order of the head's joints, rad.
        eyelids: Closing of the left and right eyelid; 0 is open.
        translation: Translation of the posed head, m.
        shape: Identity coefficients, for exports only; the identity is folded into the head.
        landmarks: Detected landmarks, px; NaN where none was detected.
        torso_to_camera: Rigid pose of the torso; equal to the head's when both are at rest.
    """

    intrinsics: Float[np.ndarray, "T 3 3"]
    world_to_camera: Float[np.ndarray, "T 4 4"]
    expression: Float[np.ndarray, "T E"]
    joint_rotations: Float[np.ndarray, "T J 3"]
    eyelids: Float[np.ndarray, "T 2"]
    translation: Float[np.ndarray, "T 3"]
    shape: Float[np.ndarray, " S"] | None = None
    landmarks: Float[np.ndarray, "T L 2"] | None = None
    torso_to_camera: Float[np.ndarray, "T 4 4"] | None = None

    def __repr__(self) -> str:
        """Numbers of frames and parameters."""
        count, axes = self.expression.shape
        return f"Tracking({count} frames, {axes} expression axes, {self.joint_rotations.shape[1]} joints)"

    def arrays(self) -> dict[str, np.ndarray]:
        """The arrays by their names in tracking.npz; those that are None are left out."""
        named = ((item.name, getattr(self, item.name)) for item in dataclasses.fields(self))
        return {name: value for name, value in named if value is not None}

    def rows(self, chosen: np.ndarray | slice) -> Tracking:
        """The tracking of a subset of the frames."""
        return Tracking(**{name: value if name == "shape" else value[chosen] for name, value in self.arrays().items()})


@dataclass(frozen=True)
class Capture:
    """An opened and checked capture folder.

    Attributes:
        folder: Path of the folder.
        subject: Name of the person in tables.
        width: Width of every image and mask, px.
        height: Height of every image and mask, px.
        fps: Frames per second.
        frames: Source frame numbers, ascending; row k of the tracking belongs to `frames[k]`.
        splits: Training and test frames by the name of the rule.
        tracking: Cameras and head parameters.
        head_version: Tag of the head's parameter space.
        source: Origin of the capture; free-form, for provenance.
        dropped: Frames of the video that are not in the capture, with the reasons.
    """

    folder: Path
    subject: str
    width: int
    height: int
    fps: float
    frames: tuple[int, ...]
    splits: Mapping[str, Split]
    tracking: Tracking
    head_version: str
    source: Mapping[str, Any] = field(default_factory=dict)
    dropped: tuple[Mapping[str, Any], ...] = ()

    def __repr__(self) -> str:
        """Subject, frames, size and folder."""
        shape = f"{len(self.frames)} frames of {self.width}×{self.height} px at {self.fps:g} fps"
        return f"{type(self).__name__}({self.subject!r}, {shape}, head {self.head_version!r}, {str(self.folder)!r})"

    @staticmethod
    def open(folder: Path | str) -> Capture:
        """Open a capture and check everything except the pixels.

        Raises:
            InputError: A file is missing, damaged, of an unknown version or inconsistent with another; the message
                names the file.
        """
        with with_remedy(Path(folder)):
            return Capture._opened(Path(folder))

    @staticmethod
    def _opened(folder: Path) -> Capture:
        described = read_description(folder / DESCRIPTION)
        tracking = Tracking(**read_tracking(folder / TRACKING))
        check_tracking(folder / TRACKING, tracking.arrays(), len(described["frames"]))
        check_head(
            folder / HEAD, described["head"]["version"], tracking.expression.shape[1], tracking.joint_rotations.shape[1]
        )
        capture = Capture(
            folder=folder,
            subject=clean_name(described["subject"]),
            width=described["width"],
            height=described["height"],
            fps=float(described["fps"]),
            frames=tuple(described["frames"]),
            splits={
                name: Split(tuple(lists["train"]), tuple(lists["test"])) for name, lists in described["splits"].items()
            },
            tracking=tracking,
            head_version=described["head"]["version"],
            source=described.get("source", {}),
            dropped=tuple(described.get("dropped", ())),
        )
        for subfolder in (IMAGES, MASKS):
            check_images(
                [capture.image_path(subfolder, number) for number in capture.frames], capture.width, capture.height
            )
        return capture

    @property
    def head_path(self) -> Path:
        """The file of the head model (`ggavatar.head.files.load_head`)."""
        return self.folder / HEAD

    def image_path(self, subfolder: str, number: int) -> Path:
        """Path of one frame's file in the subfolder `images` or `masks`."""
        return self.folder / subfolder / f"{number:06d}.png"

    def image(self, number: int) -> UInt8[np.ndarray, "H W 3"]:
        """The image of a source frame, 8-bit sRGB, read from disk on every call."""
        self.row(number)
        with with_remedy(self.folder):
            return read_rgb(self.image_path(IMAGES, number))

    def mask(self, number: int) -> UInt8[np.ndarray, "H W"]:
        """The soft foreground mask of a source frame, 255 = person, read from disk on every call."""
        self.row(number)
        with with_remedy(self.folder):
            return read_gray(self.image_path(MASKS, number))

    def row(self, number: int) -> int:
        """The tracking row of a source frame number; `InputError` if the capture does not contain the frame."""
        row = int(np.searchsorted(self.frames, number))
        if row == len(self.frames) or self.frames[row] != number:
            raise InputError(
                f"{self.folder}: no frame {number}; the capture has {len(self.frames)} frames between {self.frames[0]} "
                f"and {self.frames[-1]}"
            )
        return row

    def split(self, name: str) -> Split:
        """A split by name; `InputError` if there is none of that name."""
        if name not in self.splits:
            known = ", ".join(sorted(self.splits))
            raise InputError(
                f"{self.folder / DESCRIPTION}: no split {name!r}; available: {known}. Add it with ggavatar-prep --split"
            )
        return self.splits[name]

    def digest(self) -> str:
        """SHA-256 over the contents of every file that influences a training; reads all images."""
        total = hashlib.sha256()
        for path in self._files():
            total.update(bytes.fromhex(sha256_of(path)))
        return total.hexdigest()

    def _files(self) -> Iterator[Path]:
        yield from (self.folder / DESCRIPTION, self.folder / TRACKING, self.folder / HEAD)
        for number in self.frames:
            yield self.image_path(IMAGES, number)
            yield self.image_path(MASKS, number)

    def write_metadata(self) -> None:
        """Write tracking.npz and then capture.json, which completes the capture; each atomically."""
        write_npz(self.folder / TRACKING, self.tracking.arrays())
        splits = {name: {"train": list(split.train), "test": list(split.test)} for name, split in self.splits.items()}
        write_description(
            self.folder / DESCRIPTION,
            {
                "subject": self.subject,
                "width": self.width,
                "height": self.height,
                "fps": self.fps,
                "frames": list(self.frames),
                "splits": splits,
                "head": {"version": self.head_version},
                "source": dict(self.source),
                "dropped": [dict(item) for item in self.dropped],
            },
        )

    def write(self, images: Iterable[tuple[np.ndarray, np.ndarray]], head: Mapping[str, np.ndarray]) -> None:
        """Write the whole capture to `folder`, which must not exist; it appears complete or not at all.

        Args:
            images: Image [H, W, 3] and mask [H, W], 8-bit, of every frame in order.
            head: Arrays of head.npz.

        Raises:
            InputError: The folder exists.
        """
        if self.folder.exists():
            raise InputError(f"{self.folder}: already exists; choose another folder")
        self.folder.parent.mkdir(parents=True, exist_ok=True)
        with _AtomicFolder(self.folder) as unfinished:
            copy = dataclasses.replace(self, folder=unfinished)
            for number, (image, mask) in zip(self.frames, images, strict=True):
                write_png(copy.image_path(IMAGES, number), image)
                write_png(copy.image_path(MASKS, number), mask)
            write_npz(copy.folder / HEAD, head)
            copy.write_metadata()


class _AtomicFolder:
    """A temporary folder that is renamed to its final name on success and deleted on failure."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def __enter__(self) -> Path:
        import tempfile

        self._unfinished = Path(tempfile.mkdtemp(prefix=f".{self._folder.name}.", dir=self._folder.parent))
        return self._unfinished

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        import shutil

        if kind is None:
            self._unfinished.chmod(0o755)
            self._unfinished.rename(self._folder)
        else:
            shutil.rmtree(self._unfinished, ignore_errors=True)
