"""Seeded mutations of files: reading one may only raise an InputError that names the file, and soon."""

from __future__ import annotations

import json
import os
import random
import time

from ggavatar.errors import InputError

COUNT = int(os.environ.get("GGAVATAR_MUTATIONS", "60"))
"""Mutants per file."""

MAX_SECONDS = 10.0
"""Longest time that reading a mutant may take; most take a millisecond."""


def mutate(data: bytes, generator: random.Random) -> bytes:
    """Change some bytes, then perhaps cut the file, or repeat, insert, remove, zero or overwrite a run of bytes."""
    changed = bytearray(data or b"\0")
    for _ in range(generator.choice((1, 1, 2, 4, 16))):
        changed[generator.randrange(len(changed))] = generator.choice((0, 1, 127, 128, 255, generator.randrange(256)))
    start, length = generator.randrange(len(changed)), generator.choice((1, 4, 8, 64, 1000))
    kind = generator.random()
    if kind < 0.15:
        del changed[start:]
    elif kind < 0.25:
        changed[start:start] = changed[start : start + length]
    elif kind < 0.32:
        changed[start:start] = generator.randbytes(length)
    elif kind < 0.39:
        del changed[start : start + length]
    elif kind < 0.46:
        changed[start : start + length] = bytes(len(changed[start : start + length]))
    elif kind < 0.53:
        changed[start : start + 8] = b"\xff" * len(changed[start : start + 8])
    return bytes(changed)


def swapped(data: bytes, other: bytes, generator: random.Random) -> bytes:
    """The other file in place of this one, or its beginning before the rest of this one, or a run of it within."""
    kind, place = generator.randrange(3), generator.randrange(min(len(data), len(other)) + 1)
    if kind == 0:
        return other
    if kind == 1:
        return other[:place] + data[place:]
    length = generator.choice((4, 64, 1000))
    return data[:place] + other[place : place + length] + data[place + length :]


def refused_mutants(path, original, read, seed, count=COUNT):
    """Read many mutants of a file and count those that were refused; anything but a quick InputError is a failure."""
    generator, refused = random.Random(seed), 0
    for _ in range(count):
        path.write_bytes(mutate(original, generator))
        began = time.monotonic()
        try:
            read()
        except InputError as error:
            refused += 1
            assert path.name in str(error) or str(path.parent) in str(error)
        assert time.monotonic() - began < MAX_SECONDS
    return refused


ODD_VALUES = (None, True, -1, 10**30, 1e300, "x", "../../etc/passwd", [], {}, [[]], [1, "2"], "\0", "9" * 30)


def check_value_mutations(path, original, read, seed):
    """Replace values anywhere in a JSON file by odd ones; only InputError may be raised."""
    generator = random.Random(seed)
    for _ in range(COUNT):
        data = json.loads(original)
        spot, key = data, None
        for _ in range(generator.randint(1, 5)):
            inside = spot if key is None else spot[key]
            if not isinstance(inside, dict | list) or not inside:
                break
            spot = inside
            key = generator.choice(list(spot)) if isinstance(spot, dict) else generator.randrange(len(spot))
        spot[key] = generator.choice(ODD_VALUES)
        path.write_text(json.dumps(data))
        try:
            read()
        except InputError as error:
            assert path.name in str(error) or str(path.parent) in str(error)
