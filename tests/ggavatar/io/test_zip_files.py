"""Zip archives that would fill the memory, or whose damage zipfile reports in a dozen ways. Reference: zipfile."""

from __future__ import annotations

import struct
import zipfile
from pathlib import Path

import pytest

from ggavatar.errors import InputError
from ggavatar.io.zip_files import open_zip, read_zipped
from tests.support.damaged_files import refused_mutants


def _archive(path: Path, method: int = zipfile.ZIP_DEFLATED) -> Path:
    with zipfile.ZipFile(path, "w", method) as archive:
        archive.writestr("a", b"content" * 100)
        archive.writestr("b", b"")
    return path


def _read(path: Path) -> list[bytes]:
    with open_zip(path, "an archive") as archive:
        return [read_zipped(archive, info, 1000) for info in archive.infolist()]


@pytest.mark.parametrize("method", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
def test_members(method: int, tmp_path: Path) -> None:
    path = _archive(tmp_path / "x.zip", method)
    assert _read(path) == [b"content" * 100, b""]
    with open_zip(path, "an archive") as archive, pytest.raises(KeyError):
        read_zipped(archive, "absent", 10)


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_other_methods_are_refused(method: int, tmp_path: Path) -> None:
    """LZMA allocates the dictionary that a member names, up to 4 GB."""
    with pytest.raises(InputError, match=r"x\.zip: expected members that are stored or deflated"):
        _read(_archive(tmp_path / "x.zip", method))


def test_large_members(tmp_path: Path) -> None:
    path, wanted = _archive(tmp_path / "x.zip"), r"x\.zip: expected an archive, found"
    with pytest.raises(InputError, match=wanted), open_zip(path, "an archive") as archive:
        read_zipped(archive, "a", 699)


def test_a_long_list_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A list of 3 MB: zipfile reads it at once and makes an object of half a kilobyte from every 46 bytes."""
    path = tmp_path / "x.zip"
    entry = struct.pack("<4s6H3L5H2L", b"PK\1\2", 20, 20, 0, 0, 0, 33, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0) + b"a"
    count = 60_000
    path.write_bytes(entry * count + struct.pack("<4s4H2LH", b"PK\5\6", 0, 0, count, count, len(entry) * count, 0, 0))
    made = []
    monkeypatch.setattr(zipfile.ZipInfo, "_decodeExtra", lambda info, *_: made.append(info))
    with pytest.raises(InputError, match="list of members of more than 2 MiB"):
        _read(path)
    assert not made


def test_many_members(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "x.zip", "w") as archive:
        for number in range(4097):
            archive.writestr(str(number), b"")
    with pytest.raises(InputError, match="at most 4096 members in the archive, found 4097"):
        _read(tmp_path / "x.zip")


def test_mutations(tmp_path: Path) -> None:
    path = _archive(tmp_path / "x.zip")
    assert refused_mutants(path, path.read_bytes(), lambda: _read(path), 1, 300) > 100
