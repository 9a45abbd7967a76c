"""A small valid file of every format of Gaussians, for tests that damage them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tests.support.splat_files import SPZ_CODES, compressed_ply, ply, sog, sog_1, sog_2, spz, zipped


def plain_ply(encoding: str) -> bytes:
    generator = np.random.default_rng(0)
    names = [*"xyz", *(f"f_dc_{i}" for i in range(3)), *(f"f_rest_{i}" for i in range(9)), "opacity"]
    names += [*(f"scale_{i}" for i in range(3)), *(f"rot_{i}" for i in range(4))]
    other = {"other": {"a": np.arange(3, dtype="u1")}}
    columns = {name: generator.normal(-0.5, 1, 20).astype(np.float32) for name in names}
    return ply(other | {"vertex": columns}, encoding, comments=[b"\xff\xfe"])


def older(version: int) -> bytes:
    codes = SPZ_CODES | {"rotations": [[128, 127, 130]] * 3}
    return spz(version, codes | ({"positions": [[0.1, 0.2, 0.3]] * 3} if version == 1 else {}), 1)


def splat() -> bytes:
    generator = np.random.default_rng(0)
    floats = generator.uniform(0.01, 0.1, (40, 6)).astype("<f4").view(np.uint8).reshape(40, 24)
    return (
        np.c_[floats, generator.integers(1, 255, (40, 4)), np.full((40, 4), (255, 128, 128, 128))]
        .astype("u1")
        .tobytes()
    )


SPLATS: dict[str, Callable[[], bytes]] = {
    "ascii.ply": lambda: plain_ply("ascii"),
    "little.ply": lambda: plain_ply("binary_little_endian"),
    "big.ply": lambda: plain_ply("binary_big_endian"),
    "compressed.ply": lambda: compressed_ply(40)[1],
    "1.spz": lambda: older(1),
    "2.spz": lambda: older(2),
    "3.spz": lambda: spz(3, SPZ_CODES, 1, axes=6),
    "4.spz": lambda: spz(4, SPZ_CODES, 1, axes=6),
    "1.sog": lambda: zipped(sog(*sog_1())),
    "2.sog": lambda: zipped(sog(*sog_2())),
    "a.splat": splat,
}
"""Content by file name."""
