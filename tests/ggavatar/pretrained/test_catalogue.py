"""Where model files are searched, in which order, and what is refused; the network is replaced by a stub.

Also covers `ggavatar/io/digests.py`.
"""

from __future__ import annotations

import hashlib
import zipfile

import pytest

from ggavatar.errors import InputError
from ggavatar.pretrained import catalogue
from ggavatar.pretrained.catalogue import MODELS, Model, Version, resolve

RIGHT, OTHER = b"the network", b"the network of the wheel"


def digest(data):
    return hashlib.sha256(data).hexdigest()


@pytest.fixture
def places(tmp_path, monkeypatch):
    """Three folders and a table with one made-up model; every attempt to fetch is counted."""
    calls = []

    def download(url):
        calls.append(url)
        raise OSError("no network")

    def wheel(members):
        calls.append("wheel")
        raise ValueError("no index")

    first = Version(("net.tflite", "alias.tflite"), digest(RIGHT), "https://example.org/net.tflite")
    second = Version(("net_wheel.tflite",), digest(OTHER), None, "package/net.tflite")
    monkeypatch.setitem(MODELS, "net", Model("testing", "none", (first, second)))
    monkeypatch.setattr(catalogue, "download", download)
    monkeypatch.setattr(catalogue, "read_wheel", wheel)
    monkeypatch.setenv("GGAVATAR_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("GGAVATAR_MODELS", str(tmp_path / "environment"))
    for name in ("given", "environment", "cache/ggavatar/models"):
        (tmp_path / name).mkdir(parents=True)
    return tmp_path, calls


def test_order_of_places(places):
    folder, calls = places
    cached = folder / "cache" / "ggavatar" / "models" / "net.tflite"
    for path in (cached, folder / "environment" / "alias.tflite", folder / "given" / "net.tflite"):
        path.write_bytes(RIGHT)
        assert resolve("net", folder / "given") == path
    assert not calls


def test_wrong_contents_are_refused(places):
    folder, calls = places
    (folder / "given" / "net.tflite").write_bytes(b"something else")
    with pytest.raises(InputError, match=r"given/net\.tflite: refused.*SHA-256"):
        resolve("net", folder / "given")
    assert not calls


def test_offline_names_file_addresses_and_folder(places):
    folder, calls = places
    with pytest.raises(InputError) as caught:
        resolve("net", None, offline=True)
    message = str(caught.value)
    assert not calls and "net.tflite" in message and "https://example.org/net.tflite" in message
    assert catalogue.WHEEL in message and str(folder / "cache") in message


def test_environment_forbids_the_network(places, monkeypatch):
    monkeypatch.setenv("GGAVATAR_OFFLINE", "1")
    with pytest.raises(InputError, match="offline"):
        resolve("net")
    assert not places[1]


def test_address_then_wheel_then_error(places, monkeypatch):
    calls = places[1]
    with pytest.raises(InputError, match=r"no network.*no index"):
        resolve("net")
    assert calls == ["https://example.org/net.tflite", "wheel"]
    monkeypatch.setattr(catalogue, "read_wheel", lambda members: dict.fromkeys(members, OTHER))
    assert resolve("net").read_bytes() == OTHER
    assert resolve("net", offline=True).name == "net_wheel.tflite"


def test_fetched_contents_are_checked(places, monkeypatch):
    folder, _ = places
    monkeypatch.setattr(catalogue, "download", lambda url: b"a login page")
    with pytest.raises(InputError, match="delivered other contents"):
        resolve("net")
    assert not list((folder / "cache").rglob("*.tflite"))
    monkeypatch.setattr(catalogue, "download", lambda url: RIGHT)
    assert resolve("net").read_bytes() == RIGHT


def test_only_https_is_used():
    for url in ("http://example.org/x", "file:///etc/passwd", "ftp://example.org/x"):
        with pytest.raises(ValueError, match="https"):
            catalogue.download(url)


def test_wheel_is_opened_not_installed(tmp_path, monkeypatch):
    """pip is replaced by writing the wheel it would bring."""

    class Ran:
        returncode, stderr = 0, ""

    def pip(command, **_):
        assert command[1:4] == ["-m", "pip", "download"] and "--no-deps" in command and catalogue.WHEEL in command
        target = next(part.removeprefix("--dest=") for part in command if part.startswith("--dest="))
        with zipfile.ZipFile(f"{target}/mediapipe.whl", "w") as archive:
            archive.writestr("package/net.tflite", OTHER)
        return Ran

    monkeypatch.setattr(catalogue.subprocess, "run", pip)
    assert catalogue.read_wheel(["package/net.tflite"]) == {"package/net.tflite": OTHER}


def test_what_stands_in_is_fetched_where_the_first_choice_is_not_to_be_had(places, monkeypatch):
    """One look at the index brings all of them, and each is checked."""
    folder, calls = places
    parts = {f"package/{name}.tflite": name.encode() for name in ("a", "b")}
    for member, data in parts.items():
        version = Version((member.removeprefix("package/"),), digest(data), None, member)
        monkeypatch.setitem(MODELS, data.decode(), Model("testing", "none", (version,)))
    first = Version(("bundle.task",), digest(RIGHT), "https://example.org/bundle.task")
    monkeypatch.setitem(MODELS, "bundle", Model("testing", "none", (first,), substitutes=("a", "b")))
    with pytest.raises(InputError, match=r"bundle\.task.*no network.*Without it: .*a\.tflite.*no index"):
        catalogue.resolve_with_substitutes("bundle")

    def wheel(members):
        calls.append("fetched")
        return {member: parts.get(member, b"of another state") for member in members}

    monkeypatch.setattr(catalogue, "read_wheel", wheel)
    found = catalogue.resolve_with_substitutes("bundle")
    assert [path.read_bytes() for path in found] == [b"a", b"b"] and calls.count("fetched") == 1
    assert sorted(path.name for path in (folder / "cache/ggavatar/models").iterdir()) == ["a.tflite", "b.tflite"]
    (folder / "given" / "bundle.task").write_bytes(RIGHT)
    assert catalogue.resolve_with_substitutes("bundle", folder / "given") == (folder / "given" / "bundle.task",)
    (folder / "given" / "bundle.task").write_bytes(b"altered")
    with pytest.raises(InputError, match="refused"):
        catalogue.resolve_with_substitutes("bundle", folder / "given")


def test_table_is_complete():
    for name, model in MODELS.items():
        assert model.license and model.purpose and model.versions, name
        for version in model.versions:
            assert len(version.sha256) == 64 and (version.url or version.wheel_path)
            assert version.url is None or version.url.startswith("https://storage.googleapis.com/mediapipe-")


@pytest.mark.weights
def test_known_files_are_accepted(models_folder):
    for name in ("face_landmarker", "selfie_segmentation"):
        assert resolve(name, models_folder, offline=True).parent == models_folder
