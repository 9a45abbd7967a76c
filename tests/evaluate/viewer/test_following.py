"""Following a training: what is newer is found once, and torn files change nothing.

Reference: checkpoints and snapshots written by the training's own functions, then damaged.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping
from pathlib import Path

import pytest
import torch
from torch import Tensor

from evaluate.viewer import following
from evaluate.viewer.following import Follower, Newest, is_in_progress, open_in_progress, successor
from ggavatar.data.capture import Capture
from ggavatar.errors import InputError
from ggavatar.training.checkpoint import pack, save_checkpoint
from ggavatar.training.snapshot import SNAPSHOT, write_snapshot
from tests.support.toy_run import ToyAvatar, head, write_capture


def avatar(value: float = 0.5) -> ToyAvatar:
    made = ToyAvatar(head())
    with torch.no_grad():
        made.colors.fill_(value)
    return made


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "checkpoints").mkdir()
    return tmp_path


def save(folder: Path, step: int, value: float = 0.5) -> Path:
    return save_checkpoint(folder / "checkpoints", step, pack(avatar(value), [])[0], {})


def color(tensors: Mapping[str, Tensor]) -> float:
    return float(tensors["avatar.colors"][0, 0])


def test_what_is_newer_is_told_once(folder: Path) -> None:
    newest = Newest(folder, 10)
    assert newest.look() is None
    save(folder, 10)
    assert newest.look() is None  # it is what is shown
    save(folder, 20, 0.2)
    found = newest.look()
    assert found is not None and found[0] == 20 and color(found[1]) == pytest.approx(0.2)
    assert newest.look() is None
    write_snapshot(folder, avatar(0.3), 25)
    found = newest.look()
    assert found is not None and found[0] == 25 and color(found[1]) == pytest.approx(0.3)
    save(folder, 30, 0.4)
    found = newest.look()
    assert found is not None and found[0] == 30
    (folder / SNAPSHOT).unlink()
    assert newest.look() is None


def test_torn_checkpoints_and_snapshots_are_passed_over(folder: Path) -> None:
    newest = Newest(folder, 0)
    save(folder, 10, 0.1)
    torn = save(folder, 20)
    torn.write_bytes(torn.read_bytes()[:-7])
    write_snapshot(folder, avatar(), 30)
    whole = (folder / SNAPSHOT).read_bytes()
    (folder / SNAPSHOT).write_bytes(whole[: len(whole) // 2])
    found = newest.look()
    assert found is not None and found[0] == 10 and color(found[1]) == pytest.approx(0.1)
    (folder / "checkpoints" / "step-000000040.json").write_text("{")
    assert newest.look() is None
    (folder / SNAPSHOT).write_bytes(whole)
    found = newest.look()
    assert found is not None and found[0] == 30


def test_a_folder_that_is_removed_ends_nothing(folder: Path) -> None:
    newest = Newest(folder / "none", 0)
    assert newest.look() is None and not is_in_progress(folder / "none")


def test_a_successor_leaves_the_one_before_as_it_is() -> None:
    before = avatar(0.5)
    after = successor(before, pack(avatar(0.9), [])[0], torch.device("cpu"))
    assert isinstance(after, ToyAvatar) and not after.training
    assert (before.colors == 0.5).all() and (after.colors == 0.9).all()
    with pytest.raises(InputError, match="does not match"):
        successor(before, {"avatar.other": torch.zeros(1)}, torch.device("cpu"))


def test_the_thread_hands_over_what_it_finds(folder: Path) -> None:
    found, arrived = [], threading.Event()

    def take(one: following.Found) -> None:
        found.append(one[0])
        arrived.set()

    follower = Follower(Newest(folder, 0), take, interval=0.01)
    follower.start()
    save(folder, 3)
    assert arrived.wait(30)
    follower.stop()
    assert found == [3]


def test_a_run_without_a_checkpoint_opens_by_its_snapshot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from ggavatar.training.run_folder import RunConfig, write_config
    from ggavatar.training.session import make_trainer

    capture = write_capture(tmp_path / "capture")
    run = tmp_path / "run"
    run.mkdir()
    assert not is_in_progress(run)
    opened = Capture.open(capture.folder)
    config = RunConfig("gaussian_avatars", str(capture.folder), device="cpu", backend="reference")
    write_config(run, config, opened.splits["every-20th"])
    (run / "provenance.json").write_text("{}")
    assert not is_in_progress(run)
    trainer = make_trainer(run, config, opened, opened.splits["every-20th"])
    write_snapshot(run, trainer.avatar, 4)
    assert is_in_progress(run)
    found = open_in_progress(run, "cpu", "reference")
    assert found.step == 4 and not found.avatar.training
    (run / "checkpoints").mkdir()
    (run / SNAPSHOT).unlink()
    with pytest.raises(InputError, match="no complete checkpoint"):
        open_in_progress(run, "cpu", "reference")
