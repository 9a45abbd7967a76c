"""The viewer in a real browser: the picture is ours, controls move it, names stay texts, nothing else is asked for.

Reference: the avatar's picture, drawn by hand.
"""

from __future__ import annotations

import base64
import dataclasses
import io
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest
import torch
from PIL import Image

from evaluate.viewer import session as sessions
from evaluate.viewer.options import Options
from evaluate.viewer.orbit import added_view, filling, moved_camera
from evaluate.viewer.run_scene import RunScene
from evaluate.viewer.session import Session, open_session
from ggavatar.pictures.quantization import to_8_bit
from ggavatar.training.run_folder import Run
from tests.support.browser import Page, chromium, connected
from tests.support.toy_run import toy_run

pytestmark = pytest.mark.browser
pytest.importorskip("viser", reason="needs viser, which serves the viewer: pip install viser")

HOSTILE = "<img src=x onerror=window.owned=1>{window.owned=1}[a](javascript:window.owned=1)"
WIDTH, HEIGHT = 900, 600
PATIENCE = 90.0
LEAST_PSNR = 50.0
"""A lossless picture, smoothed by the graphics card, dB."""


@pytest.fixture
def browser() -> str:
    """The browser's command."""
    found = chromium()
    if found is None:
        pytest.skip("needs Chromium, which shows the page: apt install chromium")
    return found


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Run:
    """A run of a subject with a hostile name, whose head and method have such names too."""
    made = toy_run(tmp_path)
    named = dataclasses.replace(made, method=HOSTILE, capture=dataclasses.replace(made.capture, subject=HOSTILE))
    monkeypatch.setattr(sessions, "open_in_progress", lambda *_: named)
    monkeypatch.setattr("ggavatar.formats.web.controls.axis_names", lambda head: [f"{HOSTILE} {i}" for i in range(3)])
    return named


@contextmanager
def shown(browser: str, run: Run, profile: Path) -> Iterator[tuple[Page, Session]]:
    """The viewer of a run, open in a browser."""
    session = open_session(Options(run.folder, port=0, device="cpu", background="0.2,0.4,0.6"))
    try:
        with connected(browser, session.server.address, profile, (WIDTH, HEIGHT), is_offline=False) as page:
            yield page, session
    finally:
        session.close()


def pixels(page: Page) -> np.ndarray:
    """What is seen."""
    shot = base64.b64decode(page.call("Page.captureScreenshot", format="png")["data"])
    return np.asarray(Image.open(io.BytesIO(shot)).convert("RGB"))


def drawn(session: Session) -> np.ndarray:
    """What the window should show at its present size; nothing before that is known."""
    scene = session.drawing.scene
    assert isinstance(scene, RunScene)
    place = next((canvas.place() for canvas in session.server._canvases.values()), None)
    if place is None:
        return np.zeros((0, 0, 3), np.uint8)
    with torch.no_grad():
        drive, camera = scene.current(time.monotonic())
        # Arrow keys turn the browser's camera as well, by as much as the key is held.
        turned = moved_camera(camera, added_view(place, scene.controls.pivot, scene.controls.bounds))
        seen = filling(turned, place.width, place.height)
        return to_8_bit(scene.run.rasterize(scene.avatar.gaussians(drive), seen, scene.background).image.numpy())


def wait_for_picture(page: Page, session: Session) -> tuple[float, np.ndarray]:
    """Best PSNR of the lower left part of the window, where no notice covers it, dB; and what it is to show."""
    best, end = 0.0, time.monotonic() + PATIENCE
    while True:
        expected = drawn(session)
        if expected.size:
            part = np.s_[expected.shape[0] // 2 :, : expected.shape[1]]
            error = np.square(pixels(page)[part].astype(float) - expected[part]).mean()
            best = max(best, float(10 * np.log10(255**2 / max(error, 1e-3))))
        if best >= LEAST_PSNR or time.monotonic() > end:
            return best, expected
        time.sleep(0.2)


@pytest.mark.timeout(600)
def test_a_browser_shows_our_picture_and_moves_it(browser: str, run: Run, tmp_path: Path) -> None:
    with shown(browser, run, tmp_path / "profile") as (page, session):
        scene = session.drawing.scene
        assert isinstance(scene, RunScene)
        quality, first = wait_for_picture(page, session)
        assert quality >= LEAST_PSNR
        page.value("document.querySelector('[role=slider]').focus()")  # the position in the clip
        page.press("ArrowRight")
        end = time.monotonic() + PATIENCE
        while scene.shown.clip.start == 0 and time.monotonic() < end:
            time.sleep(0.1)
        assert scene.shown.clip.start == 1
        quality, second = wait_for_picture(page, session)
        assert (first != second).any() and quality >= LEAST_PSNR
        assert page.value("window.owned === undefined && document.querySelector('img[src=x]') === null")
        assert HOSTILE in page.value("document.body.innerText")
        hosts = {urlsplit(address).hostname for address in page.requests()} - {None, ""}
        assert hosts == {"127.0.0.1"}
