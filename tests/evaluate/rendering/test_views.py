"""Concurrent rendering and encoding: nothing lost, nothing out of order, and errors of the encoder are raised."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from evaluate.rendering import views as render_views
from evaluate.rendering.views import Output, View
from ggavatar.core import Camera, Drive, Frame, Gaussians, Rendering
from ggavatar.io.images import read_rgb


class Gray:
    """An avatar that is only a gray level."""

    def gaussians(self, drive: Drive) -> Gaussians:
        place = torch.zeros(1, 3)
        return Gaussians(place, torch.ones(1, 4), torch.ones(1, 3), torch.ones(1), drive.expression.expand(1, 3))

    def losses(self, frame: Frame, rendering: Rendering, step: int) -> dict[str, torch.Tensor]:
        raise NotImplementedError

    def optimizers(self) -> list[torch.optim.Optimizer]:
        raise NotImplementedError

    def after_backward(self, rendering: Rendering, step: int) -> None:
        raise NotImplementedError


def paint(gaussians: Gaussians, camera: Camera, background: torch.Tensor) -> Rendering:
    """The gray level as an image."""
    flat = torch.ones(camera.height, camera.width, 1)
    return Rendering(flat * gaussians.colors[0], flat, flat, torch.zeros(1, 2), torch.ones(1))


def views(count: int) -> list[View]:
    camera = Camera(torch.eye(3), torch.eye(4), 8, 8)
    empty = torch.zeros(0, 3), torch.zeros(2), torch.zeros(3), torch.eye(4)
    return [View(number, Drive(torch.tensor([number / 255]), *empty), camera) for number in range(count)]


@pytest.mark.parametrize("batch", [1, 3, 8])
def test_every_image_is_written_and_encoded_in_order(
    batch: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    appended: list[int] = []

    class Video:
        def __enter__(self) -> Callable[[np.ndarray], None]:
            return lambda image: appended.append(int(image[0, 0, 0]))

        def __exit__(self, *_: object) -> None:
            appended.append(-1)

    monkeypatch.setattr(render_views, "BATCH", batch)
    monkeypatch.setattr(render_views, "video_writer", lambda *_: Video())
    done: list[int] = []
    render_views.render_views(
        Gray(), paint, views(11), Output(tmp_path, alpha=True), lambda number, _: done.append(number)
    )
    assert appended == [*range(11), -1] and done == [*range(1, 12)]
    assert [int(read_rgb(path)[3, 3, 1]) for path in sorted((tmp_path / "frames").glob("*.png"))] == [*range(11)]
    assert len(list((tmp_path / "rgba").glob("*.png"))) == 11


def test_an_error_while_writing_is_raised(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(path: Path, image: np.ndarray) -> None:
        raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr(render_views, "write_png", full)
    with pytest.raises(OSError, match="No space left"):
        render_views.render_views(Gray(), paint, views(3), Output(tmp_path, fps=None))


def test_the_encoder_has_stopped_before_the_video_is_closed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An error in the caller's progress, such as Ctrl-C there, while a frame is being encoded."""
    events: list[str] = []

    class Video:
        def __enter__(self) -> Callable[[np.ndarray], None]:
            return self.append

        def append(self, image: np.ndarray) -> None:
            time.sleep(0.05)
            events.append("append")

        def __exit__(self, *_: object) -> None:
            events.append("close")

    def interrupt(done: int, total: int) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(render_views, "video_writer", lambda *_: Video())
    with pytest.raises(KeyboardInterrupt) as caught:
        render_views.render_views(Gray(), paint, views(11), Output(tmp_path), interrupt)
    time.sleep(0.2)
    assert caught and events[-1] == "close" and events.count("close") == 1
