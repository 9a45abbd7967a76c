"""Seeded mutations of every format of Gaussians: an InputError that names the file or sound Gaussians, soon, in bounds.

$GGAVATAR_MUTATIONS sets how many there are of each kind (60 if not set).
"""

from __future__ import annotations

import json
import random
import resource
import struct
import time
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import zstandard

from ggavatar.errors import InputError
from ggavatar.formats.gaussian_files import read_gaussians
from ggavatar.formats.splats.file_kinds import file_kind
from tests.support.damaged_files import COUNT, MAX_SECONDS, ODD_VALUES, check_value_mutations, mutate
from tests.support.splat_files import sog, sog_1, sog_2, zipped
from tests.support.splat_samples import SPLATS, plain_ply


@pytest.fixture(autouse=True)
def bounded_memory() -> Iterator[None]:
    """One gigabyte more than now, at most."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    yield
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 1 << 20


def read(path: Path) -> bool:
    """Whether a file is read, into finite numbers; otherwise it is refused by name, soon."""
    began = time.monotonic()
    try:
        rows = read_gaussians(path)
    except InputError as error:
        assert path.name in str(error) or path.parent.name in str(error)
        assert len(str(error)) < 1000
        return False
    finally:
        assert time.monotonic() - began < MAX_SECONDS
    arrays = (rows.means, rows.sh_dc, rows.sh_rest, rows.opacity_logits, rows.log_scales, rows.quats)
    assert len(rows) > 0 and all(np.isfinite(array).all() for array in arrays)
    return True


@pytest.mark.parametrize("name", SPLATS)
def test_mutated_bytes(tmp_path: Path, name: str) -> None:
    path, original, generator, refused = tmp_path / name, SPLATS[name](), random.Random(len(name)), 0
    path.write_bytes(original)
    assert read(path)
    for _ in range(COUNT):
        path.write_bytes(mutate(original, generator))
        file_kind(path)
        refused += not read(path)
    assert refused > COUNT // 20


@pytest.mark.parametrize("name", [name for name in SPLATS if name.endswith("ply")])
def test_mutated_headers(tmp_path: Path, name: str) -> None:
    """Words of the header are replaced by others, among them counts up to 10³⁰."""
    path, original, generator = tmp_path / name, SPLATS[name](), random.Random(1)
    end = original.index(b"end_header")
    words = original[:end].split(b" ")
    odd = [b"element", b"property", b"list", b"uint", b"double", b"vertex", b"x", b"\n", b"-1", b"0", b"1e9", b"9" * 12]
    odd += [b"9" * 30, b"vertex 4000000000\n", b"\xff"]
    for _ in range(COUNT):
        changed = list(words)
        for _ in range(generator.randint(1, 3)):
            changed[generator.randrange(1, len(changed))] = generator.choice(odd)
        path.write_bytes(b" ".join(changed) + original[end:])
        read(path)


@pytest.mark.parametrize("make", [sog_1, sog_2])
def test_mutated_values_of_a_sog(tmp_path: Path, make: Callable[[], tuple[dict, dict]]) -> None:
    for name, content in sog(*make()).items():
        (tmp_path / name).write_bytes(content)
    meta = tmp_path / "meta.json"
    original = meta.read_text()
    check_value_mutations(meta, original, lambda: read_gaussians(meta), 5)
    data = json.loads(original)
    for value in (*ODD_VALUES, 2**31, 1e29, -1e29, ["a" * 300] * 2, [1e308] * 3):
        for part in ("means", "scales", "quats", "sh0", "shN"):
            for key in data[part]:
                meta.write_text(json.dumps(data | {part: data[part] | {key: value}}))
                try:
                    read_gaussians(meta)
                except InputError as error:
                    assert "meta.json" in str(error) or tmp_path.name in str(error)


def test_a_line_without_end(tmp_path: Path) -> None:
    """20 MB in one line, in the header and behind it."""
    head = plain_ply("ascii")
    (tmp_path / "a.ply").write_bytes(head + b"1 " * 10_000_000)
    assert read(tmp_path / "a.ply")
    start = head.index(b"end_header\n") + len(b"end_header\n")
    (tmp_path / "a.ply").write_bytes(head[:start] + b"1 " * 10_000_000)
    assert not read(tmp_path / "a.ply")
    (tmp_path / "a.ply").write_bytes(b"ply\ncomment " + b"x" * 20_000_000)
    assert not read(tmp_path / "a.ply")


@pytest.mark.parametrize("version", [2, 4])
def test_a_small_file_of_many_gaussians(version: int, tmp_path: Path) -> None:
    """Eight million Gaussians that are all zero: packed 700 times, so that no such file is of Gaussians."""
    count = 8_000_000
    head = struct.pack("<4sIIBBBB", b"NGSP", version, count, 0, 12, 0, 0 if version == 2 else 5)
    if version == 2:
        packer = zlib.compressobj(9, wbits=31)
        data = packer.compress(head) + b"".join(packer.compress(bytes(19 * 100_000)) for _ in range(80))
        data += packer.flush()
    else:
        streams = [zstandard.ZstdCompressor().compress(bytes(count * size)) for size in (9, 1, 3, 3, 4)]
        sizes = [count * size for size in (9, 1, 3, 3, 4)]
        table = b"".join(struct.pack("<QQ", len(s), size) for s, size in zip(streams, sizes, strict=True))
        data = head + struct.pack("<I", 32) + bytes(12) + table + b"".join(streams)
    path = tmp_path / "bomb.spz"
    path.write_bytes(data)
    with pytest.raises(InputError, match=rf"bomb\.spz: the file of {len(data)} bytes is too small"):
        read_gaussians(path)


def test_a_small_image_of_many_gaussians(tmp_path: Path) -> None:
    """Images of a SOG with four million equal pixels."""
    meta, images = sog_2()
    images = {name: np.zeros((2048, 2048, 4), np.uint8) for name in images}
    meta = meta | {"count": 2048 * 2048}
    path = tmp_path / "bomb.sog"
    path.write_bytes(zipped(sog(meta, images)))
    with pytest.raises(InputError, match=r"bomb\.sog: .* is too small for 2048×2048 pixels"):
        read_gaussians(path)
