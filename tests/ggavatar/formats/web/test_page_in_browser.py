"""The page in a real browser: what it draws against our rasterizer, its controls, and what it says when it is damaged.

Also covers `formats/web/page/` (main, stage, client, renderer, panel, gestures, player, quality, orbit, embed) and
`formats/web/page.py`. An egg with random parameters is drawn: colors, opacities and shapes are wilder than any face's.
"""

from __future__ import annotations

import base64
import csv
import dataclasses
import io
import json
import re
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

from ggavatar.data.capture import Capture
from ggavatar.formats.arkit_recording import ARKIT_NAMES
from ggavatar.formats.web import export as exporting
from ggavatar.formats.web.export import export_web
from ggavatar.formats.web.options import WebOptions
from ggavatar.head.arkit_map import Target
from ggavatar.render.reference import rasterize
from ggavatar.training.run_folder import Run
from tests.support.browser import Page, chromium, opened
from tests.support.untrained_avatars import run_of, untrained

pytestmark = pytest.mark.browser

SIDE = 128
LOADING = "Loading"
HOSTILE = "</script><img src=x onerror=alert(1)>"


@pytest.fixture(scope="module")
def browser() -> str:
    """The browser's command."""
    found = chromium()
    if found is None:
        pytest.skip("needs Chromium, which draws the page: apt install chromium")
    return found


@pytest.fixture(scope="module")
def run(toy_capture: Capture) -> Run:
    """An avatar with color rows and harmonics of degree 3, of a subject with a hostile name."""
    settings = {"sh_degree": 3, "sh_iterations": 1000}
    avatar, reader = untrained("ggavatar_plus", toy_capture, 100, **settings)
    named = dataclasses.replace(toy_capture, subject=HOSTILE)
    return dataclasses.replace(run_of(avatar, reader, toy_capture), capture=named)


@pytest.fixture(scope="module")
def page(run: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its page; the egg's head has no map of ARKit's names, so it gets one."""
    path = tmp_path_factory.mktemp("web") / "avatar.html"
    with pytest.MonkeyPatch.context() as patch:
        wanted = {name: (Target("joint_rotations", 6, 0.4),) for name in ARKIT_NAMES}
        patch.setattr("ggavatar.formats.web.controls.arkit_map", lambda head: wanted)
        assert exporting.export_web is export_web
        written = export_web(run, WebOptions(prune=0.0, embed="null"), path, overwrite=False)
    assert written.psnr is not None and written.psnr > 45
    return path


@contextmanager
def shown(browser: str, page: Path, folder: Path, address: str = "", wait: float = 200.0) -> Iterator[Page]:
    """The page, once it has said something."""
    with opened(browser, page, folder, address) as view:
        end = time.monotonic() + wait
        while (text := status(view)).startswith(LOADING) and time.monotonic() < end:
            time.sleep(0.05)
        assert not text.startswith(LOADING), "the page says nothing"
        yield view


def status(view: Page) -> str:
    return str(view.value("document.getElementById('status')?.textContent ?? 'Loading'"))


def query(**more: object) -> str:
    return "?test&" + "&".join(f"{key}={value}" for key, value in {"width": SIDE, "height": SIDE, **more}.items())


SETTLED = """
const settled = async () => {
  do { await new Promise(requestAnimationFrame); } while (!ggavatar.stage.idle);
  return document.getElementById('picture').toDataURL('image/png');
};
"""


def picture(view: Page, action: str = "") -> np.ndarray:
    """The picture after an action, 0 to 255."""
    uri = view.value(f"(async () => {{ {SETTLED} {action}; return settled(); }})()")
    image = Image.open(io.BytesIO(base64.b64decode(uri.partition(",")[2])))
    return np.asarray(image.convert("RGB")).astype(np.float64)


def expected(run: Run, number: int) -> np.ndarray:
    """Our own picture of a frame, 0 to 255, in 8 bits."""
    drive = dataclasses.replace(run.reader.drive(number), frame=None)
    camera = run.reader.camera(number).resized(SIDE, SIDE)
    with torch.no_grad():
        image = rasterize(run.avatar.gaussians(drive), camera, run.background).image
    return np.rint(image.clamp(0, 1).numpy() * 255).astype(np.float64)


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    return float(10 * np.log10(255**2 / max(float(np.square(a - b).mean()), 1e-12)))


def test_it_draws_what_the_rasterizer_draws_without_network(run: Run, page: Path, browser: str, tmp_path: Path) -> None:
    with shown(browser, page, tmp_path / "a", query()) as view:
        pictures = [picture(view, f"ggavatar.seek({index})") for index in (0, 2)]
        assert view.messages() == [] or all("ReadPixels" in text for text in view.messages())
        assert {re.split("[?:]", address)[0] for address in view.requests()} == {"file", "blob"}
        assert len(view.requests()) == 2, "the page and its worker"
        assert view.value("document.getElementById('title').textContent").startswith(HOSTILE)
        assert view.value("document.images.length") == 0
    truths = [expected(run, run.split.test[index]) for index in (0, 2)]
    assert psnr(*pictures) < 35, "the two frames differ"
    assert [psnr(a, b) > 50 for a, b in zip(pictures, truths, strict=True)] == [True, True]


def test_eight_bit_targets_are_close(run: Run, page: Path, browser: str, tmp_path: Path) -> None:
    with shown(browser, page, tmp_path / "a", query(target="byte")) as view:
        assert psnr(picture(view, "ggavatar.seek(1)"), expected(run, run.split.test[1])) > 38


def live_link(path: Path) -> Path:
    """A recording in which the mouth opens, its columns in another order than ours."""
    with path.open("w", newline="") as stream:
        rows = csv.writer(stream)
        rows.writerow(["Timecode", "BlendshapeCount", *(name[0].upper() + name[1:] for name in reversed(ARKIT_NAMES))])
        for frame in range(12):
            scores = {"jawOpen": frame / 11}
            rows.writerow([f"10:00:00:{frame:02d}.000", 52, *(scores.get(name, 0) for name in reversed(ARKIT_NAMES))])
    return path


def test_controls_change_the_picture(page: Path, browser: str, tmp_path: Path) -> None:
    with shown(browser, page, tmp_path / "a", query()) as view:
        start = picture(view, "ggavatar.seek(0)")
        label = "[...document.querySelectorAll('#sliders label')].find(l => l.textContent.startsWith('jaw open'))"
        view.value(f"{label}.querySelector('input').focus()")
        view.press("ArrowRight", 60)
        assert "degrees" in view.value(f"{label}.querySelector('input').getAttribute('aria-valuetext')")
        jaw = picture(view)
        assert np.abs(jaw - start).max() > 3, "a slider by keyboard"
        view.value("document.getElementById('picture').focus()")
        view.press("ArrowLeft", 3)
        turned = picture(view)
        assert np.abs(turned - jaw).max() > 3, "the view by keyboard"
        view.press("Home")
        assert np.abs(picture(view) - jaw).max() == 0
        view.choose_file("#file", live_link(tmp_path / "take.csv"))
        closed = picture(view)
        assert "12 frames, 52 of ARKit's 52 curves" in status(view)
        assert np.abs(picture(view, "ggavatar.seek(11)") - closed).max() > 3, "a recording opens the mouth"
        (tmp_path / "bad.json").write_text('{"names": ["jawOpen"], "frames": "none"}')
        view.choose_file("#file", tmp_path / "bad.json")
        picture(view)
        assert "bad.json cannot be played: expected lists of names and frames" in status(view)
        view.value("document.getElementById('play').click()")
        before = view.value("ggavatar.player.position")
        assert view.value("document.getElementById('play').getAttribute('aria-pressed')") == "true"
        time.sleep(1.5)
        assert view.value("ggavatar.player.position") != before
        lost = "ggavatar.stage.renderer.gl.getExtension('WEBGL_lose_context')"
        view.value(f"window.lost = {lost}; lost.loseContext()")
        time.sleep(0.3)
        assert "graphics memory" in status(view)
        view.value("lost.restoreContext()")
        time.sleep(0.3)
        view.value("ggavatar.pause()")
        assert psnr(picture(view, "ggavatar.choose(0)"), start) > 60, "it comes back"


@pytest.mark.parametrize("fault", ["truncated", "flipped", "changed"])
def test_damaged_pages_say_so(fault: str, page: Path, browser: str, tmp_path: Path) -> None:
    text = page.read_text()
    start = text.index('id="avatar">') + len('id="avatar">')
    middle = (start + len(text)) // 2
    if fault == "truncated":
        text = text[:middle]
    elif fault == "flipped":
        text = text[:middle] + ("A" if text[middle] != "A" else "B") + text[middle + 1 :]
    else:
        text = text.replace("function say(", "function  say(")
    broken = tmp_path / "broken.html"
    broken.write_text(text)
    with opened(browser, broken, tmp_path / "b") as view:
        end = time.monotonic() + (100 if fault != "changed" else 2)
        while status(view).startswith(LOADING) and time.monotonic() < end:
            time.sleep(0.05)
        if fault == "changed":
            assert "incomplete or was changed" in status(view), "the policy blocks a script that is not ours"
        else:
            assert "damaged" in status(view) and "Save the page again" in status(view)
        assert not any("exceptionId" in text for text in view.messages())


def test_another_page_can_drive_it(page: Path, browser: str, tmp_path: Path) -> None:
    host = tmp_path / "host.html"
    host.write_text(
        "<!doctype html><title>host</title><p id='status'>Loading</p>"
        f"<iframe id='frame' width='300' height='300' src={json.dumps(page.as_uri() + '#picture')}></iframe>"
        "<script>window.heard = []; onmessage = (e) => { heard.push(e.data); document.getElementById('status')"
        ".textContent = e.data.ggavatar; };</script>"
    )
    with shown(browser, host, tmp_path / "a") as view:
        assert view.value("heard[0].ggavatar") == "ready" and "jawOpen" in view.value("heard[0].arkit")
        send = "document.getElementById('frame').contentWindow.postMessage({message}, '*')"
        for message in ('{ggavatar: "drive", arkit: {jawOpen: 1}}', '{ggavatar: "drive", arkit: {jawOpen: "x"}}'):
            view.value(send.replace("{message}", message))
        end = time.monotonic() + 20
        while view.value("heard.length") < 2 and time.monotonic() < end:
            time.sleep(0.05)
        assert view.value("heard.slice(1)") == [
            {"ggavatar": "error", "message": "drive: expected finite numbers in arkit and head"}
        ]


def test_a_phone_shows_all_of_it(page: Path, browser: str, tmp_path: Path) -> None:
    with shown(browser, page, tmp_path / "a") as view:
        view.resize(390, 800, "dark")
        wide = view.value("document.documentElement.scrollWidth")
        assert wide == 390, "nothing is cut off at the side"
        view.screenshot(tmp_path / "phone.png")
        with Image.open(tmp_path / "phone.png") as seen:
            assert seen.size == (390, 800)
        dark: Any = view.value("getComputedStyle(document.body).backgroundColor")
        assert dark == "rgb(22, 23, 26)"
