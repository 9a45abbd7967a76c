"""pip's configuration, written by the test into pip's own files and variables and read back through pip."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from ggavatar.pretrained import pip_settings
from ggavatar.pretrained.pip_settings import IndexSettings, read_pip_settings


@pytest.fixture(autouse=True)
def no_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in os.environ if name.startswith("PIP_")]:
        monkeypatch.delenv(name)
    monkeypatch.setenv("PIP_CONFIG_FILE", os.devnull)


def test_without_configuration_it_is_the_public_index() -> None:
    assert read_pip_settings() == IndexSettings()


def test_files_and_variables_are_read_and_variables_win(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "pip.conf"
    file.write_text(
        "[global]\nindex-url = https://one.invalid/simple\ntrusted-host = a.invalid b.invalid\ncert = /ca.pem\n"
        "extra-index-url =\n    https://two.invalid/simple\n    https://three.invalid/simple\n"
        "[download]\nproxy = http://proxy.invalid:1\n[install]\nno-index = true\n"
    )
    monkeypatch.setenv("PIP_CONFIG_FILE", str(file))
    monkeypatch.setenv("PIP_FIND_LINKS", "/wheels")
    monkeypatch.setenv("PIP_DEFAULT_TIMEOUT", "180")
    found = read_pip_settings()
    assert found == IndexSettings(
        index="https://one.invalid/simple",
        extra_indexes=("https://two.invalid/simple", "https://three.invalid/simple"),
        find_links=("/wheels",),
        no_index=False,
        trusted_hosts=("a.invalid", "b.invalid"),
        certificate="/ca.pem",
        proxy="http://proxy.invalid:1",
        timeout=180.0,
    )
    monkeypatch.setenv("PIP_INDEX_URL", "https://four.invalid/simple")
    monkeypatch.setenv("PIP_NO_INDEX", "true")
    found = read_pip_settings()
    assert found.index == "https://four.invalid/simple" and found.no_index


def test_without_pip_the_variables_are_read(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(*_: object, **__: object) -> None:
        raise FileNotFoundError

    monkeypatch.setattr(subprocess, "run", missing)
    monkeypatch.setenv("PIP_INDEX_URL", "https://it's.invalid/simple")
    assert pip_settings.read_pip_settings().index == "https://it's.invalid/simple"
