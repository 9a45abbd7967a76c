"""The on-disk cache of compiled kernels: what it depends on, where it is, and which files in it are trusted.

Numba only compares a kernel's own source file with its cache. Here the cache folder is named after a digest of every
file that the kernel can inline or take a constant from, and every cache file carries a digest of its own contents.
"""

from __future__ import annotations

import ast
import atexit
import contextlib
import functools
import hashlib
import io
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from numba.core.caching import FunctionCache, IndexDataCacheFile

from ggavatar.io.cache_folder import cache_folder
from ggavatar.jit.private_folder import is_own_file, is_private

PACKAGES = ("ggavatar", "preprocess", "evaluate")
"""Packages whose sources a kernel may depend on."""

ROOT = Path(__file__).parents[2]
DIGEST_BYTES = hashlib.sha256().digest_size


@functools.cache
def imported_files(path: Path, root: Path) -> frozenset[Path]:
    """Files of our packages below `root` that the source file `path` imports, anywhere in the file."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_bytes())):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert not node.level and node.module, f"{path}:{node.lineno}: a relative import, which is not followed"
            names.update({node.module, *(f"{node.module}.{alias.name}" for alias in node.names)})
    ours = [root.joinpath(*name.split(".")).with_suffix(".py") for name in names if name.split(".")[0] in PACKAGES]
    return frozenset(file for file in ours if file.is_file())


def kernel_sources(path: Path, root: Path = ROOT) -> tuple[Path, ...]:
    """The source file `path` and all files of our packages that it imports, directly or indirectly; sorted."""
    found, waiting = {path}, [path]
    while waiting:
        for file in imported_files(waiting.pop(), root) - found:
            found.add(file)
            waiting.append(file)
    return tuple(sorted(found))


@functools.cache
def source_digest(path: Path, root: Path = ROOT) -> str:
    """Digest of all sources that the kernels in `path` depend on, 12 hexadecimal digits."""
    digest = hashlib.sha256()
    for file in kernel_sources(path, root):
        name = file.relative_to(root).as_posix() if file.is_relative_to(root) else file.name
        digest.update(f"{name}\0".encode() + file.read_bytes() + b"\0")
    return digest.hexdigest()[:12]


def kernel_folder() -> Path:
    """The folder for compiled kernels, created if missing: $NUMBA_CACHE_DIR or the user's cache, else a temporary one.

    Cache files are executed, so a folder that others could have written to is not used, and ours is closed to them.
    """
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    folder = Path(chosen).absolute() / "ggavatar" if chosen else cache_folder("compiled").absolute()
    with contextlib.suppress(OSError):
        _make_private(folder)
        folder = folder.parent.resolve() / folder.name  # links above it could be changed after the check
        if is_private(folder) and os.access(folder, os.W_OK):
            folder.chmod(0o700)
            return folder
    private = Path(tempfile.mkdtemp(prefix="ggavatar-compiled-"))
    atexit.register(_remove, private, os.getpid())
    sys.stderr.write(
        f"compiled kernels are kept in {private} for this process only: {folder} is not a folder that this user alone "
        "can write to; set $GGAVATAR_CACHE to one\n"
    )
    return private


def _make_private(folder: Path) -> None:
    """Create a folder and those above it that are missing, all closed to others, whatever the umask allows."""
    missing = [parent for parent in (folder, *folder.parents) if not parent.exists()]
    for parent in reversed(missing):
        parent.mkdir(mode=0o700, exist_ok=True)


def _remove(folder: Path, owner: int) -> None:
    """Remove a temporary folder when the process that made it ends; forked children leave it alone."""
    if os.getpid() == owner:
        shutil.rmtree(folder, ignore_errors=True)


def _signature(path: str, content: bytes) -> bytes:
    """Digest of a cache file's name and content, so that a copy under another name does not match."""
    return hashlib.sha256(os.path.basename(path).encode() + b"\0" + content).digest()


def _is_intact(path: str) -> bool:
    """Whether a cache file exists, is this user's, complete and unchanged."""
    try:
        content = Path(path).read_bytes() if is_own_file(path) else b""
    except OSError:
        return False
    return content[-DIGEST_BYTES:] == _signature(path, content[:-DIGEST_BYTES])


class _CheckedCacheFile(IndexDataCacheFile):
    """Numba's index and data files with a digest appended; a damaged one counts as missing."""

    @contextlib.contextmanager
    def _open_for_write(self, filepath: str) -> Iterator[io.BytesIO]:
        with super()._open_for_write(filepath) as file:
            content = io.BytesIO()
            yield content
            file.write(content.getvalue() + _signature(filepath, content.getvalue()))

    def _load_index(self) -> dict[Any, str]:
        return super()._load_index() if _is_intact(self._index_path) else {}

    def _load_data(self, name: str) -> Any:
        if not _is_intact(self._data_path(name)):
            raise FileNotFoundError(name)  # makes the caller recompile
        return super()._load_data(name)


class KernelCache(FunctionCache):
    """Numba's cache of one function, in checked files; if the disk is full, the kernel is just not cached."""

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        stamp = self._impl.locator.get_source_stamp()
        self._cache_file = _CheckedCacheFile(self._cache_path, self._impl.filename_base, stamp)

    def is_below(self, folder: Path) -> bool:
        """Whether the files are in `folder`."""
        return Path(self._cache_path).is_relative_to(folder)

    def save_overload(self, sig: Any, data: Any) -> None:
        """Store the machine code of one signature; write errors are ignored."""
        with contextlib.suppress(OSError):
            super().save_overload(sig, data)
