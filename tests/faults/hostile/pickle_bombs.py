"""Pickles that take time, memory or stack out of all proportion, and tensors that are not in their file."""

from __future__ import annotations

import pickle
import struct
from collections.abc import Iterator

import numpy as np

from tests.faults.hostile.bases import FILES
from tests.faults.hostile.fixture import Hostile
from tests.faults.hostile.pickles import as_frames, as_pickle, plain, text, with_pickle
from tests.faults.hostile.samples import torch_file


def fixtures() -> list[Hostile]:
    """All of them."""
    return list(bombs())


def bombs() -> Iterator[Hostile]:
    """Pickles that hang, exhaust the memory or the stack."""
    for name, data in _bombs().items():
        yield as_pickle(name, data, refused=False)
        if len(data) < 1 << 20:
            yield as_frames(name, data, refused=False)
            files = {"generic_model.pkl": data}
            yield Hostile(name, FILES, "head", "generic_model.pkl", files, True)
    for name, data in _tensor_bombs().items():
        for reader in ("pickle", "weights"):
            yield Hostile(name, FILES, reader, "zip.pt", {"zip.pt": with_pickle(torch_file(False), data)})


def _doubling(level: int, close: bytes) -> bytes:
    """A value that holds the one before twice, that many times."""
    return b"".join(b"0(h" + bytes([n]) + b"h" + bytes([n]) + close + b"q" + bytes([n + 1]) for n in range(level))


def _array(shape: bytes, kind: bytes, data: bytes) -> bytes:
    """A numpy array as pickled, with the parts as opcodes."""
    head = b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\n(K\x00tC\x01btR(K\x01" + shape
    return (
        head
        + b"cnumpy\ndtype\n("
        + kind
        + b"K\x00K\x01tR(K\x03U\x01<NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb\x89"
        + data
        + b"tb"
    )


def _bombs() -> dict[str, bytes]:
    start, many = b"\x80\x02", 200_000
    big = text("x" * 600_000)
    encode = b"c_codecs\nencode\n" + big + b"q\x01" + text("latin1") + b"q\x02\x86R"
    return {
        "tuples as keys that double": start + b"Nq\x00" + _doubling(60, b"t") + b"}" + b"h\x3cNs.",
        "tuples in a set that double": b"\x80\x04Nq\x00" + _doubling(60, b"t") + b"\x8f(h\x3c\x90.",
        "frozenset of doubling tuples": b"\x80\x04Nq\x00" + _doubling(60, b"t") + b"(h\x3c\x91.",
        "lists that double": start + b"Nq\x00" + _doubling(200, b"l") + b".",
        "dictionaries that double": start + b"Nq\x00" + _doubling(60, b"t") + b".",
        "the same text encoded 2,000 times": start
        + b"("
        + encode
        + (b"c_codecs\nencode\nh\x01h\x02\x86R") * 2000
        + b"l.",
        "nested 200,000 deep": start + b"]" * many + b"a" * (many - 1) + b".",
        "nested tuples 200,000 deep": start + b"N" + b"\x85" * many + b".",
        "marks without end": start + b"(" * (10 * many),
        "a million empty lists": start + b"(" + b"]" * 1_000_000 + b"l.",
        "three million empty dictionaries": start + b"(" + b"}" * 3_000_000 + b"l.",
        "duplicates without end": start + b"](" + b"2" * 1_000_000 + b"l.",
        "a list that holds itself": start + b"]q\x00h\x00a.",
        "a dictionary that holds itself": start + b"}q\x00K\x01h\x00s.",
        "memo index of 2^31": start + b"Nr\xff\xff\xff\x7f.",
        "memo index of 2^64": b"\x80\x02Np18446744073709551615\n.",
        "a million memo entries": start + b"N" + b"".join(b"r" + struct.pack("<I", n) for n in range(300_000)) + b".",
        "a frame of 2^60 bytes": b"\x80\x04\x95" + struct.pack("<Q", 1 << 60) + b"N.",
        "bytes of 2^60": b"\x80\x04\x8e" + struct.pack("<Q", 1 << 60) + b"x.",
        "text of 2^60": b"\x80\x04\x8d" + struct.pack("<Q", 1 << 60) + b"x.",
        "a bytearray of 2^40": b"\x80\x05\x96" + struct.pack("<Q", 1 << 40) + b"x.",
        "bytes of 4 GB": start + b"B" + struct.pack("<I", 0xFFFFFFFF) + b"x.",
        "text of 4 GB": start + b"X" + struct.pack("<I", 0xFFFFFFFF) + b"x.",
        "a negative length": start + b"T" + struct.pack("<i", -1) + b"x.",
        "a whole number of 2 GB": start + b"\x8b" + struct.pack("<i", (1 << 31) - 1) + b"x.",
        "a whole number of negative size": start + b"\x8b" + struct.pack("<i", -5) + b"x.",
        "a number of a million digits": b"I" + b"9" * 1_000_000 + b"\n.",
        "a long of a million digits": b"L" + b"9" * 1_000_000 + b"L\n.",
        "a float of a million digits": b"F" + b"9" * 1_000_000 + b"\n.",
        "a line without end": b"S'" + b"x" * 1_000_000,
        "escapes": b"S'" + b"\\x41" * 250_000 + b"'\n.",
        "unicode escapes": b"V" + b"\\u0041" * 100_000 + b"\n.",
        "an array of 2^62 numbers": start
        + _array(b"\x8a\x08" + struct.pack("<q", 1 << 62) + b"\x85", b"U\x02f8", b"C\x00")
        + b".",
        "an array of negative size": start + _array(b"J\xff\xff\xff\xff\x85", b"U\x02f8", b"C\x00") + b".",
        "an array of 60 dimensions": start + _array(b"(" + b"K\x00" * 60 + b"t", b"U\x02f8", b"C\x00") + b".",
        "numbers of 2^31 bytes": start + _array(b"K\x00\x85", b"U\x0bS2147483647", b"C\x00") + b".",
        "empty texts of 2^29 characters": start + _array(b"K\x01\x85", b"U\x0aU536870911", b"C\x00") + b".",
        "an array of objects": start + _array(b"K\x01\x85", b"U\x01O", b"]Na") + b".",
        "a structured array": start + _array(b"K\x01\x85", b"U\x05i4,i4", b"C\x08aaaaaaaa") + b".",
        "an empty file": b"",
        "one byte": b"\x80",
        "protocol 255": b"\x80\xff.",
        "stop at once": b".",
        "a stack that is empty": start + b"0000.",
        "a set item without a dictionary": start + b"NNNs.",
        "an append to a number": start + b"K\x01Na.",
        "a build of text": start + text("x") + b"}b.",
        "unhashable keys": start + b"}]Ns.",
        "zeros": bytes(100_000),
        "two pickles": pickle.dumps(1) + pickle.dumps(2),
        "sparse matrix of 2^40 entries": _sparse((1 << 20, 1 << 20)),
        "sparse matrix outside of itself": _sparse((4, 4), rows=99),
    }


def _sparse(shape: tuple[int, int], rows: int = 0) -> bytes:
    from tests.support.flame_files import chumpy_pickle

    arrays = {"data": np.ones(1), "indices": np.array([rows]), "indptr": np.array([0, 1])}
    return chumpy_pickle({"J_regressor": ("csc", {"_shape": shape, **arrays})})


def _tensor_bombs() -> dict[str, bytes]:
    """data.pkl of torch's zip whose tensors are not what their storage can hold."""

    def tensor(count: int, offset: int, size: tuple[int, ...], stride: tuple[int, ...]) -> bytes:
        storage = b"(" + text("storage") + b"ctorch\nFloatStorage\n" + text("0") + text("cpu") + plain(count) + b"tQ"
        view = plain(offset) + plain(size) + plain(stride) + b"\x89ccollections\nOrderedDict\n)R"
        return b"\x80\x02}" + text("weight") + b"ctorch._utils\n_rebuild_tensor_v2\n(" + storage + view + b"tRs."

    return {
        "a tensor of one number spread to 10^10": tensor(24, 0, (100_000, 100_000), (0, 0)),
        "a tensor of one number spread to 10^8": tensor(24, 0, (10_000, 10_000), (0, 0)),
        "a tensor beyond its storage": tensor(24, 20, (24,), (1,)),
        "a tensor of negative stride": tensor(24, 20, (20,), (-1,)),
        "a tensor of negative size": tensor(24, 0, (-1, 3), (3, 1)),
        "a tensor at a negative place": tensor(24, -8, (2,), (1,)),
        "a storage of 2^60 numbers": tensor(1 << 60, 0, (1 << 60,), (1,)),
        "a storage of negative size": tensor(-1, 0, (2,), (1,)),
        "a tensor of huge stride": tensor(24, 0, (2, 2), (1 << 62, 1 << 62)),
        "a tensor of 60 dimensions": tensor(24, 0, (1,) * 60, (1,) * 60),
        "a tensor without numbers": tensor(24, 0, (0, 1 << 62), (1, 1)),
    }
