"""A fixture: a tree of valid files that is changed before it is read; and what became of the reading."""

from __future__ import annotations

import os
import random
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from tests.support.damaged_files import mutate, swapped

REFUSED, ACCEPTED, FAULT = "refused", "accepted", "FAULT"


@dataclass(frozen=True)
class Fixture:
    """A change of a valid tree, and the reader that then opens it.

    Attributes:
        name: For the report; unique among those of a row.
        base: The tree, a key of `bases.BASES`.
        reader: A key of `readers.READERS`.
        target: What the reader opens, relative to the tree.
    """

    name: str
    base: str
    reader: str
    target: str = "."

    def plant(self, tree: Path) -> list[str]:
        """Change the tree; returns the changed files, relative to it."""
        raise NotImplementedError

    @property
    def must_refuse(self) -> bool:
        """Whether reading it without an error is a fault too."""
        return False


@dataclass(frozen=True)
class Hostile(Fixture):
    """Files written by an attacker.

    Attributes:
        files: Their content by path; None removes the file, a `Special` is no regular file, `Repeated` a large one.
        refused: No harmless content can be read out of it.
    """

    files: Mapping[str, bytes | Repeated | Special | None] = field(default_factory=dict)
    refused: bool = False

    def plant(self, tree: Path) -> list[str]:
        """Write the files."""
        for name, content in self.files.items():
            path = tree / name
            remove(path)
            path.parent.mkdir(parents=True, exist_ok=True)
            if isinstance(content, bytes | Repeated):
                path.write_bytes(bytes(content))
            elif content is not None:
                content.make(path)
        return list(self.files)

    @property
    def must_refuse(self) -> bool:
        """As said."""
        return self.refused


@dataclass(frozen=True)
class Repeated:
    """Many bytes, held as few.

    Attributes:
        head, unit, tail: The content is the head, the unit `count` times, and the tail.
    """

    head: bytes
    unit: bytes
    count: int
    tail: bytes = b""

    def __bytes__(self) -> bytes:
        return self.head + self.unit * self.count + self.tail

    def __len__(self) -> int:
        return len(self.head) + len(self.unit) * self.count + len(self.tail)


@dataclass(frozen=True)
class Special:
    """A file that is none: a FIFO, a device, a link or a folder.

    Attributes:
        kind: `fifo`, `link` or `folder`.
        to: Where a link leads.
    """

    kind: str
    to: str = ""

    def make(self, path: Path) -> None:
        """Create it."""
        if self.kind == "fifo":
            os.mkfifo(path)
        elif self.kind == "link":
            path.symlink_to(self.to)
        else:
            path.mkdir()


@dataclass(frozen=True)
class Mutated(Fixture):
    """One file changed at random.

    Attributes:
        file: The file, relative to the tree.
        seed: Of the random numbers.
        other: File that parts are swapped with.
    """

    file: str = ""
    seed: int = 0
    other: str = ""

    def plant(self, tree: Path) -> list[str]:
        """Rewrite the file."""
        generator, path = random.Random(self.seed), tree / self.file
        data = path.read_bytes()
        if self.other and generator.random() < 0.1:
            data = swapped(data, (tree / self.other).read_bytes(), generator)
        else:
            data = mutate(data, generator)
        path.write_bytes(data)
        return [self.file]


@dataclass(frozen=True)
class Flipped(Fixture):
    """One bit of one file flipped.

    Attributes:
        file: The file, relative to the tree.
        seed: Of the random numbers.
    """

    file: str = ""
    seed: int = 0

    def plant(self, tree: Path) -> list[str]:
        """Rewrite the file."""
        path, generator = tree / self.file, random.Random(self.seed)
        data = bytearray(path.read_bytes())
        data[generator.randrange(len(data))] ^= 1 << generator.randrange(8)
        path.write_bytes(data)
        return [self.file]


@dataclass(frozen=True)
class Reading:
    """What became of a fixture.

    Attributes:
        verdict: `REFUSED` by an InputError that names the file, `ACCEPTED` without harm, or `FAULT`.
        detail: The message, or what went wrong.
        seconds: Time of the reading.
        megabytes: Memory that it took beyond what was there before, MB.
    """

    verdict: str
    detail: str
    seconds: float = 0.0
    megabytes: float = 0.0


def remove(path: Path) -> None:
    """Remove whatever is there."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
