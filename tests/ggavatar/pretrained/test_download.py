"""Downloads from an address: which addresses are used, and where a download ends."""

from __future__ import annotations

import io
import sys
import urllib.request

import pytest

from ggavatar.pretrained import download as module
from ggavatar.pretrained.download import download, show_download


def test_only_https_is_used() -> None:
    for url in ("http://example.org/x", "file:///etc/passwd", "ftp://example.org/x"):
        with pytest.raises(ValueError, match="https"):
            download(url, 1)


def test_contents_are_read_up_to_the_limit(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(urllib.request, "urlopen", lambda url, timeout: io.BytesIO(b"x" * 100))
    assert download("https://example.org/x", 2_000_000) == b"x" * 100
    assert capsys.readouterr().err == "downloading https://example.org/x (2.0 MB)\n"
    monkeypatch.setattr(module, "MAX_DOWNLOAD", 99)
    with pytest.raises(ValueError, match="more than"):
        download("https://example.org/x", 100)


def test_a_terminal_shows_a_bar_and_keeps_stdout_clean(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "120")
    with show_download("a network", 100) as received:
        received(50)
    shown = capsys.readouterr()
    assert "a network" in shown.err and shown.out == ""
