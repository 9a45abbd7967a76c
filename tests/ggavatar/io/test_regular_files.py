"""Pipes, devices, sockets and folders are refused by every reader at once, and files of any size in bounded memory.

Also covers `ggavatar/io/digests.py`.
"""

from __future__ import annotations

import hashlib
import os
import socket
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from ggavatar.errors import InputError
from ggavatar.formats.arkit_recording import read_arkit_recording
from ggavatar.formats.gaussian_files import read_gaussians
from ggavatar.formats.splats.ply import read_header
from ggavatar.formats.splats.splat import read_splat
from ggavatar.formats.splats.spz_reader import read_spz
from ggavatar.io.digests import sha256_of, sha256_of_folder
from ggavatar.io.images import image_header, read_gray, read_rgb
from ggavatar.io.json_files import read_json
from ggavatar.io.npz import npz_headers, read_npy, read_npz
from ggavatar.io.regular_files import open_regular, read_file, read_start, regular_size
from ggavatar.io.restricted_pickle import read_pickle
from ggavatar.landmarks.bundle import load_network, read_member
from ggavatar.pretrained.weights import load_weights
from ggavatar.training.journal import Journal, read_journal
from preprocess.video.decoding import Video

posix = pytest.mark.skipif(os.name != "posix", reason="pipes and devices of POSIX")

READERS: dict[str, Callable[[Path], Any]] = {
    "open": open_regular,
    "bytes": lambda path: read_file(path, 1 << 20),
    "start": lambda path: read_start(path, 4),
    "size": regular_size,
    "digest": sha256_of,
    "json": read_json,
    "npz": read_npz,
    "npz headers": npz_headers,
    "npy": lambda path: read_npy(path, 1 << 20),
    "pickle": read_pickle,
    "image": read_rgb,
    "mask": read_gray,
    "image header": image_header,
    "ply": read_header,
    "splat": read_splat,
    "spz": read_spz,
    "recording": read_arkit_recording,
    "weights": load_weights,
    "bundle": lambda path: read_member(path, "landmarks"),
    "network": lambda path: load_network(path.with_suffix(".tflite"), "landmarks"),
    "journal": lambda path: read_journal(path) or Journal(path, 0),
    "video": Video,
}


def _within(seconds: float, read: Callable[[], object]) -> BaseException | None:
    """What `read` raises, in a thread of its own; a failure if it takes longer."""
    raised: list[BaseException] = []

    def run() -> None:
        try:
            read()
        except BaseException as error:
            raised.append(error)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    thread.join(seconds)
    assert not thread.is_alive(), "waits for a pipe"
    return raised[0] if raised else None


@posix
@pytest.mark.parametrize("name", READERS)
@pytest.mark.parametrize("kind", ["pipe", "device", "socket", "folder"])
def test_only_regular_files_are_read(kind: str, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "odd.tflite"
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "device":
        path.symlink_to("/dev/zero")
    elif kind == "socket":
        monkeypatch.chdir(tmp_path)  # names of sockets are short
        with socket.socket(socket.AF_UNIX) as bound:
            bound.bind(path.name)
    else:
        path.mkdir()
    raised = _within(20, lambda: READERS[name](path))
    assert isinstance(raised, InputError) and str(path) in str(raised)


@posix
def test_the_message_names_the_kind_and_a_next_step(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match=r"expected a JSON file, found a pipe; write what comes out of it into a file"):
        read_json(tmp_path / "pipe")
    with pytest.raises(InputError, match="found a device"):
        read_json(Path("/dev/null"))


@posix
def test_a_pipe_that_takes_the_place_of_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The path was a file when it was asked, and is a pipe when it is opened."""
    (tmp_path / "file").write_text("")
    os.mkfifo(tmp_path / "pipe")
    status = os.stat(tmp_path / "file")
    monkeypatch.setattr(os, "stat", lambda *_, **__: status)
    raised = _within(20, lambda: open_regular(tmp_path / "pipe"))
    assert isinstance(raised, InputError) and "found a pipe" in str(raised)


def test_names_that_are_no_files(tmp_path: Path) -> None:
    for path in (tmp_path / "absent", tmp_path / "a\0b", tmp_path / ("a" * 300)):
        with pytest.raises(InputError, match="no such file"):
            read_file(path, 10)
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="no such file"):
        read_file(tmp_path / "file" / "below", 10)


def test_sizes(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"0123456789")
    assert read_file(path, 10) == b"0123456789" and read_start(path, 4) == b"0123" and regular_size(path) == 10
    for read in (lambda: read_file(path, 9, "a list"), lambda: regular_size(path, "a list", 9)):
        with pytest.raises(InputError, match="expected a list of at most 9 bytes, found 10 bytes"):
            read()
    with path.open("wb") as stream:
        stream.truncate(1 << 40)  # a terabyte that takes no space
    with pytest.raises(InputError, match=r"at most 512 KiB, found 1048576 MiB"):
        read_file(path, 1 << 19)


def test_digests(tmp_path: Path) -> None:
    """Reference: hashlib over the same bytes."""
    for name, content in (("b", b"2" * 3_000_000), ("a", b"1")):
        (tmp_path / name).write_bytes(content)
    (tmp_path / "folder").mkdir()
    assert sha256_of(tmp_path / "b") == hashlib.sha256(b"2" * 3_000_000).hexdigest()
    wanted = hashlib.sha256(b"a\0" + b"1" + b"b\0" + b"2" * 3_000_000).hexdigest()
    assert sha256_of_folder(tmp_path) == wanted


@posix
def test_gaussian_files(tmp_path: Path) -> None:
    """The kind is asked before a reader is chosen."""
    for suffix in ("ply", "splat", "spz", "sog"):
        os.mkfifo(tmp_path / f"x.{suffix}")
        raised = _within(20, lambda suffix=suffix: read_gaussians(tmp_path / f"x.{suffix}"))
        assert isinstance(raised, InputError)


@pytest.mark.skipif(not os.path.exists("/proc/self/mem"), reason="needs a file that is regular by name only")
@pytest.mark.parametrize("read", [read_json, read_rgb, read_gaussians, read_pickle, lambda path: read_file(path, 9)])
def test_a_file_that_cannot_be_read_is_named(read: Callable[[Path], Any], tmp_path: Path) -> None:
    """The memory of a process fails at address 0 as a bad disk does."""
    path = tmp_path / "broken.ply"
    path.symlink_to("/proc/self/mem")
    with pytest.raises(InputError, match=r"broken\.ply: cannot be read \(Input/output error\)"):
        read(path)
