"""Digests of files."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

from ggavatar.io.regular_files import open_regular


def sha256_of(path: Path) -> str:
    """SHA-256 of a regular file's contents, lower-case hexadecimal; `InputError` if it is none."""
    with open_regular(path) as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def sha256_of_folder(folder: Path) -> str:
    """SHA-256 of the names and contents of the files in a folder, in the order of their names; not of its folders."""
    total = hashlib.sha256()
    for entry in sorted(folder.iterdir()):
        if entry.is_file():
            total.update(os.fsencode(entry.name) + b"\0")
            with open_regular(entry) as stream:
                while block := stream.read(1 << 20):
                    total.update(block)
    return total.hexdigest()
