"""A run on show: its avatar under sliders or a clip, beside the video, with the error between them."""

from __future__ import annotations

import dataclasses
import threading
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field

import numpy as np
import torch
from jaxtyping import UInt8

from evaluate.figures.error_map import error_colors
from evaluate.viewer.orbit import Place, added_view, filling, moved_camera
from evaluate.viewer.playback import Playback
from evaluate.viewer.posing import Controls, Turn
from evaluate.viewer.tiles import side_by_side, tile_size
from ggavatar.core import Camera, Drive
from ggavatar.data.capture_without_images import CaptureWithoutImages
from ggavatar.data.frames import evenly_spaced
from ggavatar.formats.web.clips import clip_rate
from ggavatar.pictures.quantization import to_8_bit
from ggavatar.training.run_folder import Run

AVATAR, BESIDE, ERROR = MODES = ("avatar", "video beside", "error map")
ERROR_LIMIT = 0.3
"""Absolute error that has the brightest color."""
CLIPS = {"test frames": "test", "training frames": "train", "all frames": "all"}
MAX_RANGE_FRAMES = 500
"""Training frames from which ranges of sliders are taken."""


@dataclass(frozen=True)
class Shown:
    """What is shown of a run.

    Attributes:
        clip: The frames, and where they stand.
        mode: One of `MODES`.
        drive: Made by sliders or a live performance; None follows the clip.
        camera: Sees `drive`; None is the camera at rest.
        turn: Of the head, added.
        free: Whether the view may turn to where training never saw the head.
        version: Counts the changes, of the avatar too.
    """

    clip: Playback
    mode: str = AVATAR
    drive: Drive | None = None
    camera: Camera | None = None
    turn: Turn = field(default_factory=Turn)
    free: bool = False
    version: int = 0


class RunScene:
    """The scene of a run. Its state is replaced as a whole, by any thread; pictures are drawn by one."""

    def __init__(self, run: Run, background: torch.Tensor | None = None) -> None:
        self.run = run
        self.avatar = run.avatar
        self.background = run.background if background is None else background
        head = run.head.to(run.background.device, torch.float32)
        frames = evenly_spaced(run.split.train or run.capture.frames, MAX_RANGE_FRAMES)
        camera = run.reader.camera(run.capture.frames[0])
        self.controls = Controls.of(head, [run.reader.drive(number) for number in frames], camera)
        self._lock = threading.Lock()
        self.shown = Shown(self.clip_of(next(name for name in CLIPS if self.frames_of(name))))
        self.changed: Callable[[], None] = lambda: None
        self.gaussians = 0
        self.beside: UInt8[np.ndarray, "H W 3"] | None = None
        """A performer, shown beside the avatar."""

    @property
    def modes(self) -> tuple[str, ...]:
        """Those of `MODES` that the run can be shown in: an avatar file has no video to compare with."""
        return (AVATAR,) if isinstance(self.run.capture, CaptureWithoutImages) else MODES

    def frames_of(self, name: str) -> tuple[int, ...]:
        """Frame numbers of one of `CLIPS`."""
        split = self.run.split
        return {"test": split.test, "train": split.train, "all": self.run.capture.frames}[CLIPS[name]]

    def clip_of(self, name: str) -> Playback:
        """One of `CLIPS` that has frames, at its beginning."""
        frames = self.frames_of(name)
        return Playback(frames, clip_rate(frames, self.run.capture.fps))

    def update(self, change: Callable[[Shown], Shown]) -> None:
        """Replace what is shown."""
        with self._lock:
            self.shown = dataclasses.replace(change(self.shown), version=self.shown.version + 1)
        self.changed()

    def replace_avatar(self, avatar: torch.nn.Module, step: int) -> None:
        """Show another avatar of the same run, such as a newer one."""
        self.avatar, self.run = avatar, dataclasses.replace(self.run, avatar=avatar, step=step)
        self.count()
        self.update(lambda shown: shown)

    def count(self) -> None:
        """Count the Gaussians."""
        self.gaussians = len(self.avatar.gaussians(self.controls.rest).means)

    def moment(self, now: float) -> Hashable:
        """What the picture depends on besides a browser's camera."""
        shown = self.shown
        follows = shown.drive is None or shown.mode != AVATAR
        return shown.version, shown.clip.index(now) if follows else None

    def plays(self) -> bool:
        """Whether the clip plays."""
        return self.shown.clip.is_playing

    def current(self, now: float) -> tuple[Drive, Camera]:
        """Drive and camera, without the view that a browser adds."""
        shown = self.shown
        if shown.drive is not None:
            drive, camera = shown.drive, shown.camera or self.controls.camera
        else:
            number = shown.clip.frame(now)
            drive, camera = self.run.reader.drive(number), self.run.reader.camera(number)
        return self.controls.turned(drive, camera, shown.turn)

    def picture(self, place: Place, size: tuple[int, int], now: float) -> UInt8[np.ndarray, "H W 3"]:
        """The picture for a browser's camera."""
        shown = self.shown
        if self.beside is not None and shown.mode == AVATAR:
            return self._beside_performer(place, size, now)
        if shown.mode == AVATAR:
            return self._avatar(place, size, now)
        return self._compared(shown, size, now)

    def _avatar(self, place: Place, size: tuple[int, int], now: float) -> UInt8[np.ndarray, "H W 3"]:
        drive, camera = self.current(now)
        bounds = None if self.shown.free else self.controls.bounds
        seen = moved_camera(camera, added_view(place, self.controls.pivot, bounds))
        return self._rendered(drive, filling(seen, *size))

    def _beside_performer(self, place: Place, size: tuple[int, int], now: float) -> UInt8[np.ndarray, "H W 3"]:
        beside = self.beside
        assert beside is not None
        half = (max(1, size[0] // 2), size[1])
        return side_by_side([self._avatar(place, half, now), beside], size, self._color())

    def _compared(self, shown: Shown, size: tuple[int, int], now: float) -> UInt8[np.ndarray, "H W 3"]:
        """The frame of the clip as rendered and as filmed, by the camera that filmed it, and the error."""
        number = shown.clip.frame(now)
        count = 2 if shown.mode == BESIDE else 3
        capture = self.run.capture
        width, height = tile_size((capture.width, capture.height), size, count)
        width, height = min(width, capture.width), min(height, capture.height)
        frame = self.run.reader.frame(number, width, height)
        rendered = self._rendered(frame.drive, frame.camera)
        truth = to_8_bit(frame.image.float().cpu().numpy())
        tiles = [rendered, truth]
        if shown.mode == ERROR:
            error = np.abs(rendered.astype(np.float32) - truth).mean(axis=2) / 255
            tiles.append(error_colors(error, ERROR_LIMIT))
        return side_by_side(tiles, size, self._color())

    def _rendered(self, drive: Drive, camera: Camera) -> UInt8[np.ndarray, "H W 3"]:
        image = self.run.rasterize(self.avatar.gaussians(drive), camera, self.background).image
        return to_8_bit(image.float().cpu().numpy())

    def _color(self) -> tuple[int, int, int]:
        red, green, blue = (round(255 * value) for value in self.background.tolist())
        return red, green, blue
