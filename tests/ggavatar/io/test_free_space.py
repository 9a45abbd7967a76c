"""Free space is checked before the work; a command that lacks it ends with exit code 1 and leaves nothing."""

from __future__ import annotations

import errno
import shutil
from collections import namedtuple
from pathlib import Path

import pytest

from ggavatar.io import free_space
from ggavatar.io.free_space import require_space
from preprocess.cli.demo import main

Usage = namedtuple("Usage", "total used free")


def test_more_than_is_free_is_refused(tmp_path: Path) -> None:
    """What the operating system says is the reference."""
    free = shutil.disk_usage(tmp_path).free
    require_space(tmp_path / "new" / "folder", free // 2)
    with pytest.raises(OSError, match="MB are needed") as caught:
        require_space(tmp_path / "new" / "folder", 100 * free)
    assert caught.value.errno == errno.ENOSPC and not (tmp_path / "new").exists()


def test_a_disk_that_does_not_tell_is_tried(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(_: Path) -> None:
        raise PermissionError

    monkeypatch.setattr(free_space.shutil, "disk_usage", refuse)
    require_space(tmp_path, 1 << 60)


def test_a_demo_is_refused_before_it_is_rendered(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(free_space.shutil, "disk_usage", lambda _: Usage(1 << 20, 1 << 20, 1000))
    assert main(["-o", str(tmp_path / "demo")]) == 1
    assert "No space left on device: at least" in (text := capsys.readouterr().err) and "another folder with -o" in text
    assert not (tmp_path / "demo").exists()
