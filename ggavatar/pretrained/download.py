"""Downloads from an address, and the progress of downloads on stderr."""

from __future__ import annotations

import sys
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from ggavatar.pretrained.catalogue import MAX_DOWNLOAD
from ggavatar.text.terminal import write_err

TIMEOUT_SECONDS = 30
"""How long a server may stay silent."""

CHUNK = 1 << 16

Received = Callable[[int], None]
"""Is called with the bytes received so far."""


@contextmanager
def show_download(source: str, size: int) -> Iterator[Received]:
    """Gives a callback that shows the progress of a download: a bar on a terminal, elsewhere one line when it begins.

    Args:
        source: What is downloaded from where.
        size: Bytes.
    """
    if not sys.stderr.isatty():
        write_err(f"downloading {source} ({size / 1e6:.1f} MB)")
        sys.stderr.flush()
        yield lambda received: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TransferSpeedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), DownloadColumn(), TransferSpeedColumn())
    with Progress(*columns, console=Console(stderr=True), redirect_stdout=False, transient=True) as bar:
        task = bar.add_task(f"downloading {source}", total=size)
        yield lambda received: bar.update(task, completed=received)


def download(url: str, size: int) -> bytes:
    """The contents of an https address.

    Args:
        url: The address.
        size: Expected bytes, for the progress bar.

    Raises:
        OSError: The server cannot be reached or refuses.
        ValueError: The address is not https, or the contents exceed `MAX_DOWNLOAD`.
    """
    if not url.startswith("https://"):
        raise ValueError(f"expected an https address, found {url}")
    data = bytearray()
    with urllib.request.urlopen(url, timeout=TIMEOUT_SECONDS) as answer, show_download(url, size) as received:
        while chunk := answer.read(CHUNK):
            data += chunk
            received(len(data))
            if len(data) > MAX_DOWNLOAD:
                raise ValueError(f"more than {MAX_DOWNLOAD >> 20} MiB")
    return bytes(data)
