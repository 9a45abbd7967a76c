"""Work and memory of hostile pickles are bounded: under ten seconds of the processor and a gigabyte each.

Also covers `ggavatar/io/pickle_stand_ins.py`.
"""

from __future__ import annotations

import pickle
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from ggavatar.errors import InputError
from ggavatar.io.restricted_pickle import read_pickle
from tests.support.measured import costs

MAX_SECONDS, MAX_MIB = 10, 1000
MANY = 3_500_000


def text(content: bytes) -> bytes:
    return b"X" + struct.pack("<I", len(content)) + content


def repeated(start: bytes, part: bytes, count: int, end: bytes = b".") -> Callable[[], bytes]:
    return lambda: b"\x80\x04" + start + part * count + end


def colliding_keys() -> bytes:
    """Keys whose hash is 0, as all multiples of 2⁶¹ - 1 have."""
    numbers = (((1 << 61) - 1) * factor for factor in range(1, 100_000))
    longs = (number.to_bytes(12, "little") for number in numbers)
    return b"\x80\x04}(" + b"".join(b"\x8a\x0c" + number + b"N" for number in longs) + b"u."


def sparse(starts: np.ndarray, data: object = np.ones(1)) -> bytes:
    """A matrix of scipy with the given `indptr` and `data`."""
    state = {"_shape": (4, 2), "data": data, "indices": np.zeros(1, np.int32), "indptr": starts}
    body = pickle.dumps(state, 4)[2:-1]
    return b"\x80\x04cscipy.sparse\ncsc_matrix\n)\x81" + body + b"b."


EXPENSIVE: dict[str, Callable[[], bytes]] = {
    "lists": repeated(b"", b"]", MANY),
    "dictionaries": repeated(b"", b"}", MANY),
    "marks": repeated(b"", b"(", MANY),
    "sets": repeated(b"", b"\x8f", MANY),
    "frozen sets": repeated(b"", b"(\x91", MANY),
    "remembered lists": repeated(b"", b"]\x94", MANY),
    "tuples in tuples": repeated(b"N", b"\x85", MANY),
    "dictionaries with an entry": repeated(b"", b"}NNs", MANY),
    "copies of a reference": repeated(b"]", b"2", MANY),
    "arrays without contents": repeated(b"cnumpy.core.multiarray\n_reconstruct\n\x94", b"h\x00)R", MANY // 4),
    "number types": repeated(b"cnumpy\ndtype\n\x94", b"h\x00)R", MANY // 4),
    "objects of chumpy": repeated(b"cchumpy.ch\nCh\n\x94", b"h\x00)\x81", MANY // 4),
    "an argument for every letter": lambda: b"\x80\x04ccollections\nOrderedDict\n" + text(b"a" * MANY) + b"R.",
    "an argument for every byte": lambda: b"\x80\x04cnumpy\ndtype\nB" + struct.pack("<I", MANY) + bytes(MANY) + b"R.",
    "a new object of letters": lambda: b"\x80\x04cnumpy\ndtype\n" + text(b"a" * MANY) + b"\x81.",
    "a module of dots": lambda: b"\x80\x04" + text(b"." * MANY) + text(b"a") + b"\x93.",
    "wide text": repeated(b"", text("😀".encode() + b"a" * 4_000_000), 20),
    "sizes of a large tuple": lambda: (
        b"\x80\x04(" + b"K\x00" * 100_000 + b"t\x94ctorch\nSize\n\x94" + b"h\x01h\x00\x85R" * 100_000 + b"."
    ),
    "state set again and again": lambda: (
        b"\x80\x04cchumpy.ch\nCh\n)R\x94}\x94("
        + b"".join(text(b"%d" % key) + b"N" for key in range(20_000))
        + b"u0"
        + b"h\x00h\x01b" * 300_000
        + b"."
    ),
    "keys with one hash": colliding_keys,
    "unsigned starts": lambda: sparse(np.array([0, 1 << 63, 1], np.uint64)),
    "starts that fall": lambda: sparse(np.array([0, 1 << 62, 1], np.int64)),
    "texts as a matrix": lambda: sparse(np.array([0, 1, 1]), ["a" * 1_000_000, *["b"] * 100_000]),
    "frame of an exabyte": lambda: b"\x80\x04\x95" + struct.pack("<Q", 1 << 60) + b"N.",
    "bytes of an exabyte": lambda: b"\x80\x04\x8e" + struct.pack("<Q", 1 << 60) + b"a.",
    "text of an exabyte": lambda: b"\x80\x04\x8d" + struct.pack("<Q", 1 << 60) + b"a.",
    "array of an exabyte": lambda: b"\x80\x05\x96" + struct.pack("<Q", 1 << 60) + b"a.",
    "number of two gigabytes": lambda: b"\x80\x02\x8b\xff\xff\xff\x7f.",
    "number of many digits": lambda: b"L" + b"9" * MANY + b"L\n.",
}


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> dict[str, object]:
    """What every file costs, all read by one process."""
    folder = tmp_path_factory.mktemp("expensive")
    files = []
    for number, make in enumerate(EXPENSIVE.values()):
        files.append(folder / f"{number}.frame")
        files[-1].write_bytes(make())
    return dict(zip(EXPENSIVE, costs("ggavatar.io.restricted_pickle", "read_pickle", files), strict=True))


@pytest.mark.slow
@pytest.mark.timeout(1200)  # of the clock; what is measured is time of the processor
@pytest.mark.parametrize("name", EXPENSIVE)
def test_work_and_memory_are_bounded(name: str, measured: dict) -> None:
    found = measured[name]
    assert found.seconds < MAX_SECONDS and found.peak < MAX_MIB, found
    if name not in ("wide text", "state set again and again", "frame of an exabyte"):
        assert found.message and ".frame: " in found.message, found


@pytest.mark.slow
def test_large_plain_data_is_still_read(tmp_path: Path) -> None:
    """Three hundred thousand numbers and texts in dictionaries, as a clip's coefficients might be saved."""
    content = {f"{number:05d}": {"expr": [0.5 * number] * 20, "name": f"frame {number}"} for number in range(12_000)}
    (tmp_path / "clip.pkl").write_bytes(pickle.dumps(content, 4))
    assert read_pickle(tmp_path / "clip.pkl") == content


@pytest.mark.parametrize("key", [1 << 60, -(1 << 60), (1,), 1j, frozenset([1])])
def test_keys_are_names_and_small_numbers(key: object, tmp_path: Path) -> None:
    for content in ({key: 1}, {key}):
        (tmp_path / "keys.pkl").write_bytes(pickle.dumps(content, 4))
        with pytest.raises(InputError, match=r"keys\.pkl"):
            read_pickle(tmp_path / "keys.pkl")
    (tmp_path / "keys.pkl").write_bytes(pickle.dumps({(1 << 60) - 1: 1, "a": 2, 0.5: 3, None: 4}, 4))
    assert read_pickle(tmp_path / "keys.pkl")[0.5] == 3
