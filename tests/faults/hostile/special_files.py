"""FIFOs, devices, links and folders where files are expected."""

from __future__ import annotations

from tests.faults.hostile.bases import FILES, RUN
from tests.faults.hostile.fixture import Hostile, Special
from tests.faults.hostile.samples import READERS_OF

KINDS = {
    "a FIFO": Special("fifo"),
    "a folder": Special("folder"),
    "/dev/zero": Special("link", "/dev/zero"),
    "/dev/urandom": Special("link", "/dev/urandom"),
    "/dev/full": Special("link", "/dev/full"),
    "/dev/null": Special("link", "/dev/null"),
    "/proc/kmsg": Special("link", "/proc/kmsg"),
    "/proc/self/mem": Special("link", "/proc/self/mem"),
    "a link to itself": Special("link", "victim-loop"),
    "a link to nothing": Special("link", "no-such-file"),
    "no file": None,
}
"""What is there instead of a file."""

_PARTS = {
    "capture/capture.json": "capture",
    "capture/tracking.npz": "capture",
    "capture/head.npz": "capture",
    "capture/images/000001.png": "capture",
    "capture/masks/000001.png": "capture",
    "run/config.json": "run",
    "run/split.json": "run",
    "run/provenance.json": "run",
    "run/checkpoints/step-000000003.json": "run",
    "run/checkpoints/step-000000003.safetensors": "run",
}


def fixtures() -> list[Hostile]:
    """Every file that is read on its own, and those of a capture and a run, with the kinds in turn."""
    found = []
    for number, (name, readers) in enumerate(READERS_OF.items()):
        for title, kind in list(KINDS.items())[number % 3 :: 3]:
            for reader in readers:
                special = Special("link", name) if title == "a link to itself" else kind
                found.append(Hostile(f"{title} as {name}", FILES, reader, name, {name: special}, True))
    for number, (name, reader) in enumerate(_PARTS.items()):
        for title, kind in list(KINDS.items())[number % 2 :: 2]:
            special = Special("link", name.rpartition("/")[2]) if title == "a link to itself" else kind
            target = name.partition("/")[0]
            found.append(Hostile(f"{title} as {name}", RUN, reader, target, {name: special}, True))
    return found
