"""Fetches archives from the package index that pip is configured for, and reads files in them.

Even `pip download` runs the setup script of a source archive; unearth resolves and downloads it and does nothing else.
Only named members are read, into memory, so nothing in an archive can choose a path.
"""

from __future__ import annotations

import logging
import ssl
import tarfile
import zipfile
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from ggavatar.pretrained.catalogue import MAX_DOWNLOAD, Archive
from ggavatar.pretrained.download import Received, show_download
from ggavatar.pretrained.pip_settings import IndexSettings, read_pip_settings

if TYPE_CHECKING:
    from unearth import Link, PackageFinder
    from unearth.fetchers import PyPIClient

logging.getLogger("unearth").addHandler(logging.NullHandler())  # its warnings about unused indexes are not for users


def fetch_archive(archive: Archive, folder: Path) -> Path:
    """Download an archive and verify its digest.

    The sources of pip's configuration are tried one after the other, so that one that is down or holds another file
    of that name does not hide the next.

    Args:
        archive: What to fetch.
        folder: Where it may be put; an archive in a local index stays where it is.

    Raises:
        ValueError: No source has it; the message says why, and names no host.
    """
    settings = read_pip_settings()
    failures = []
    with _client(settings) as client:
        for finder in _finders(settings, client):
            try:
                return _fetch_from(finder, archive, folder)
            except Exception as error:  # those of unearth, of its HTTP client and of ssl share no base but Exception
                failures.append(_reason(error))
    raise ValueError(", ".join(dict.fromkeys(failures)) or "pip's configuration names no index")


def _fetch_from(finder: PackageFinder, archive: Archive, folder: Path) -> Path:
    packages = finder.find_all_packages(archive.project, allow_yanked=True)
    link = next((package.link for package in packages if package.link.filename == archive.file), None)
    if link is None:
        raise _Undelivered(f"lists no {archive.file}")
    with show_download(str(archive), archive.size) as received:
        return finder.download(link, folder, {"sha256": [archive.sha256]}, _limited(received, archive.size))


class _Undelivered(Exception):
    """A source does not have the archive, or delivers something else; the message is ours and names no host."""


def _limited(received: Received, size: int) -> Callable[[Link, int, int | None], None]:
    """A callback for unearth: shows the progress, and stops a download that is longer than the archive."""

    def report(link: Link, completed: int, total: int | None) -> None:
        received(completed)
        if completed > size:
            raise _Undelivered(f"delivers more than {size} bytes")

    return report


def _client(settings: IndexSettings) -> PyPIClient:
    """An HTTP client with pip's settings; credentials in addresses and in .netrc are used, none are asked for."""
    from unearth.auth import MultiDomainBasicAuth
    from unearth.fetchers import PyPIClient

    verify = ssl.create_default_context(cafile=settings.certificate) if settings.certificate else True
    addresses = [address for address in (settings.index, *settings.extra_indexes) if address]
    return PyPIClient(
        auth=MultiDomainBasicAuth(prompting=False, index_urls=addresses),
        trusted_hosts=settings.trusted_hosts,
        verify=verify,
        timeout=settings.timeout,
        proxy=settings.proxy,
        follow_redirects=True,
    )


def _finders(settings: IndexSettings, client: PyPIClient) -> Iterator[PackageFinder]:
    """One finder for every source: folders of links, the index, further indexes."""
    from unearth import PackageFinder

    if settings.find_links:
        yield PackageFinder(client, find_links=settings.find_links, ignore_compatibility=True)
    if not settings.no_index:
        main = (settings.index,) if settings.index else ()  # none: unearth's default, the public index
        yield PackageFinder(client, index_urls=main, ignore_compatibility=True)
        for address in settings.extra_indexes:
            yield PackageFinder(client, index_urls=(address,), ignore_compatibility=True)


def _reason(error: Exception) -> str:
    """Why a source did not deliver; messages of the libraries are not passed on, since they name hosts."""
    from unearth.errors import HashMismatchError

    if isinstance(error, HashMismatchError):
        return "delivers other contents than the SHA-256 says"
    if isinstance(error, _Undelivered):
        return str(error)
    return f"cannot be reached ({type(error).__name__})"


def read_members(path: Path, names: Iterable[str]) -> dict[str, bytes]:
    """The named files of a .whl or .tar.gz archive; those that it lacks, and links, are left out.

    Raises:
        ValueError: The archive is damaged, or one of the files is larger than `MAX_DOWNLOAD`.
    """
    try:
        read = _read_zip if path.suffix in (".whl", ".zip") else _read_tar
        return read(path, set(names))
    except (zipfile.BadZipFile, tarfile.TarError, EOFError, OSError) as error:
        raise ValueError(f"damaged archive ({type(error).__name__})") from error


def _read_zip(path: Path, names: set[str]) -> dict[str, bytes]:
    with zipfile.ZipFile(path) as archive:
        infos = [info for info in archive.infolist() if info.filename in names]
        _check_sizes((info.filename, info.file_size) for info in infos)
        return {info.filename: archive.read(info) for info in infos}


def _read_tar(path: Path, names: set[str]) -> dict[str, bytes]:
    found = {}
    with tarfile.open(path, "r:gz") as archive:
        for member in archive:
            stream = archive.extractfile(member) if member.isreg() and member.name in names else None
            if stream is not None:
                _check_sizes([(member.name, member.size)])
                found[member.name] = stream.read()
    return found


def _check_sizes(sizes: Iterable[tuple[str, int]]) -> None:
    for name, size in sizes:
        if size > MAX_DOWNLOAD:
            raise ValueError(f"{name}: more than {MAX_DOWNLOAD >> 20} MiB")
