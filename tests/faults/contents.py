"""What a folder holds, without times and memory: for comparisons, and to see that no file is half written."""

from __future__ import annotations

import hashlib
import json
import re
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import av
import numpy as np
from PIL import Image
from safetensors import safe_open

MEASURED = frozenset(
    {"started", "argv", "seconds", "training_seconds", "peak_memory_mib", "peak_gpu_memory_mib"}
    | {"peak_memory_megabytes", "efficiency", "timing", "record_sha256", "content_sha256"}
)
"""Keys of JSON files whose values are times, memory, the command line, and digests over them."""
COSTS = "efficiency"
"""Name of the table of times and memory."""
NUMBER = re.compile(r"\d+(?:[.,]\d+)*")
NOT_COMPARED = re.compile(r"\.log$")
"""Files that tell the story of how they came about: only their existence is compared."""


def contents(root: Path) -> dict[str, str]:
    """A digest of every file of a folder (or of one file) by its name, of what does not depend on time or place."""
    home = str(root.resolve().parent)
    files = [root] if root.is_file() else sorted(path for path in root.rglob("*") if not path.is_dir())
    return {path.relative_to(root).as_posix() if path != root else "": _digest(path, home) for path in files}


def differences(found: Mapping[str, str], expected: Mapping[str, str]) -> list[str]:
    """What is missing, different or too much, one sentence each."""
    missing = [f"{name}: missing" for name in expected if name not in found]
    more = [f"{name}: left over" for name in found if name not in expected]
    other = [f"{name}: differs" for name, digest in expected.items() if found.get(name, digest) != digest]
    return [*missing, *more, *other]


def half_written(root: Path) -> list[str]:
    """The files under a final name that cannot be read to their end, one sentence each."""
    wrong = []
    for path in [root] if root.is_file() else sorted(root.rglob("*")):
        if path.is_file() and not path.name.startswith("."):  # temporary files and locks
            try:
                _read_whole(path)
            except Exception as error:
                wrong.append(f"{path.relative_to(root)}: half written ({type(error).__name__}: {error})")
    return wrong


def _digest(path: Path, home: str) -> str:
    """The digest of one file; `home` is left out of the paths that it names."""
    if path.is_symlink():
        return f"link to {path.readlink()}"
    if NOT_COMPARED.search(path.name):
        return "not compared"
    try:
        if path.suffix == ".json":
            return _digest_of(json.dumps(_without_times(json.loads(path.read_text()))).replace(home, "").encode())
        if path.suffix == ".jsonl":
            lines = [_without_times(json.loads(line)) for line in path.read_text().splitlines()]
            return _digest_of(json.dumps(lines).encode())
        if path.suffix == ".mp4":
            return _digest_of(b"".join(frame.tobytes() for frame in _frames(path)))
        if path.suffix == ".csv":
            lines = [line for line in path.read_text().splitlines() if not line.startswith(f"{COSTS},")]
            return _digest_of("\n".join(lines).encode())
        if path.suffix in (".md", ".tex", ".html"):  # their numbers are those of the JSON and CSV files, and times
            return _digest_of(NUMBER.sub("0", path.read_text()).encode())
    except Exception as error:
        return f"unreadable: {error}"
    return _digest_of(path.read_bytes())


def _digest_of(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def _without_times(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_times(part) for key, part in value.items() if key not in MEASURED}
    if isinstance(value, list):
        return [_without_times(part) for part in value if not (isinstance(part, dict) and part.get("name") == COSTS)]
    return value


def _frames(path: Path) -> list[np.ndarray]:
    with av.open(str(path)) as container:
        return [frame.to_ndarray(format="yuv420p") for frame in container.decode(video=0)]


def _read_whole(path: Path) -> None:
    """Read a file to its end.

    Raises:
        Exception: It is damaged or cut off.
    """
    kind = path.suffix
    if kind == ".json":
        json.loads(path.read_text())
    elif kind in (".png", ".jpg"):
        with Image.open(path) as image:
            image.load()
    elif kind in (".npz", ".zip", ".ggavatar"):
        with zipfile.ZipFile(path) as archive:
            assert archive.testzip() is None
    elif kind == ".mp4":
        assert _frames(path)
    elif kind == ".safetensors":
        with safe_open(path, "numpy") as tensors:
            for name in tensors.keys():  # noqa: SIM118 - not a mapping
                tensors.get_tensor(name)
