"""A session: the run that is opened is served, and pictures reach a client without a browser.

Also covers `evaluate/viewer/options.py`. Reference: the avatar's picture at rest, drawn by hand.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from evaluate.viewer import session as sessions
from evaluate.viewer.capture_scene import CaptureScene
from evaluate.viewer.file_scene import FileScene
from evaluate.viewer.options import Options, check, with_first_camera
from evaluate.viewer.session import Session, background_of, open_session, view
from ggavatar.errors import InputError
from ggavatar.formats.splats.gaussian_ply import write_gaussian_ply
from ggavatar.formats.splats.stored_gaussians import to_stored
from ggavatar.training.run_folder import Run
from tests.support.gaussian_cloud import cloud
from tests.support.toy_run import toy_run

pytest.importorskip("viser", reason="needs viser, which serves the viewer: pip install viser")


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Run:
    made = toy_run(tmp_path)
    monkeypatch.setattr(sessions, "open_in_progress", lambda *_: made)
    return made


@pytest.fixture
def opened(run: Run) -> Iterator[Session]:
    found = open_session(Options(run.folder, port=0, device="cpu"))
    yield found
    found.close()


class Client(SimpleNamespace):
    """A client as viser hands it over, that keeps the pictures it gets."""

    def __init__(self, number: int) -> None:
        camera = SimpleNamespace(
            image_width=64, image_height=48, wxyz=np.array([0.0, 1, 0, 0]), position=np.array([0.0, 0, 1]),
            on_update=lambda callback: None,
        )  # fmt: skip
        storage = SimpleNamespace(get_item=lambda key, timeout: None)
        super().__init__(
            client_id=number, camera=camera, pictures=[], local_storage=storage, flush=lambda: None
        )  # fmt: skip
        self.scene = SimpleNamespace(set_background_image=lambda image, **how: self.pictures.append((image, how)))

    def wait(self, count: int) -> None:
        end = time.monotonic() + 30
        while len(self.pictures) < count and time.monotonic() < end:
            time.sleep(0.01)
        assert len(self.pictures) >= count


def test_two_clients_get_pictures_and_one_may_leave(opened: Session, run: Run) -> None:
    clients = [Client(101), Client(102)]
    for client in clients:
        opened.server._opened(client)
    for client in clients:
        client.wait(2)
        image, how = client.pictures[-1]
        assert image.shape == (48, 64, 3) and how == {"format": "png"} and client.pictures[0][1]["format"] == "jpeg"
    opened.server._closed(clients[0])
    clients[1].camera.position = np.array([0.2, 0, 1])
    before = len(clients[0].pictures)
    clients[1].wait(4)
    assert len(clients[0].pictures) == before


def test_captures_and_files_are_told_by_what_they_are(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "cloud.ply"
    write_gaussian_ply(path, to_stored(cloud()))
    for shown, kind in ((run.capture.folder, CaptureScene), (path, FileScene)):
        session = open_session(Options(shown, port=0, device="cpu", backend="reference"))
        client = Client(101)
        session.server._opened(client)
        client.wait(1)
        session.close()
        assert isinstance(session.drawing.scene, kind)


def test_only_runs_are_driven(run: Run) -> None:
    with pytest.raises(InputError, match="--webcam"):
        open_session(Options(run.capture.folder, port=0, webcam="0"))


def test_a_camera_that_is_missing_leaves_no_server_behind(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(*_: object) -> None:
        raise InputError("no camera")

    (run.folder / "config.json").write_text("{}")
    monkeypatch.setattr("evaluate.viewer.performance.performer_of", missing)
    before = threading.active_count()
    with pytest.raises(InputError, match="no camera"):
        open_session(Options(run.folder, port=0, webcam="0", device="cpu"))
    assert threading.active_count() <= before


def test_it_ends_when_it_is_told_to(run: Run, capsys: Any) -> None:
    ended = threading.Event()
    ended.set()
    view(Options(run.folder, port=0, public=True, device="cpu"), ended)
    said = capsys.readouterr()
    assert said.out.startswith("open http://127.0.0.1:") and "--public" in said.err


def test_options_are_checked_first(run: Run) -> None:
    with pytest.raises(InputError, match="65536"):
        check(Options(Path("run"), port=65536))
    with pytest.raises(InputError, match="purpleish"):
        check(Options(Path("run"), background="purpleish"))
    check(Options(Path("run"), port=0, background="black"))
    assert background_of(Options(Path("run"), background="black"), run.background).tolist() == [0, 0, 0]
    assert background_of(Options(Path("run")), run.background) is run.background


@pytest.mark.parametrize(
    ("given", "completed"),
    [
        (["run", "--webcam"], ["run", "--webcam", "0"]),
        (["--webcam", "--port", "1", "run"], ["--webcam", "0", "--port", "1", "run"]),
        (["run", "--webcam", "2"], ["run", "--webcam", "2"]),
        (["run", "--webcam", "me.mp4"], ["run", "--webcam", "me.mp4"]),
        (["run"], ["run"]),
    ],
)
def test_the_first_camera_needs_no_number(given: list[str], completed: list[str]) -> None:
    assert with_first_camera(given) == completed
