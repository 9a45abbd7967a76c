"""Archives of arrays (npz, npy) and zip files that lie about sizes, expand without end or hold what is no array."""

from __future__ import annotations

import functools
import io
import lzma
import struct
import zipfile
import zlib
from collections.abc import Iterator

import numpy as np

from tests.faults.hostile.bases import FILES, RUN
from tests.faults.hostile.fixture import Hostile
from tests.faults.hostile.samples import ARRAYS, BUNDLE, npy, npz
from tests.faults.hostile.samples import FILES as FILES_BY_NAME
from tests.faults.hostile.zeros import shared_zip

_READERS = {
    **{"plain.npz": "npz", "head.npz": "head", "flame.npz": "head", "take.npz": "recording"},
    **{"flame_param.npz": "parameters", "driving.npz": "driving", "2.sog": "gaussians", "zip.pt": "pickle"},
}
_MEMBERS = ("a", "version", "template", "v_template", "names", "scores", "expression", "expr", "shape")
"""Names that some reader asks for."""


def header(text: bytes, version: bytes = b"\x01\x00", length: int | None = None) -> bytes:
    """An npy file with any header, without data."""
    size = len(text) if length is None else length
    return b"\x93NUMPY" + version + struct.pack("<H" if version == b"\x01\x00" else "<I", size) + text


def described(descr: str, shape: str, order: str = "False") -> bytes:
    """The text of a header."""
    return f"{{'descr': {descr}, 'fortran_order': {order}, 'shape': {shape}, }}\n".encode()


HEADERS: dict[str, bytes] = {
    "a shape of 2^62": header(described("'<f8'", f"({1 << 62},)")),
    "a shape of 10^11 numbers": header(described("'<f8'", "(99999999999,)")),
    "a shape that overflows to 0": header(described("'<f8'", f"({1 << 32}, {1 << 32})")),
    "a negative shape": header(described("'<f8'", "(-1,)")),
    "two negative sizes": header(described("'<f8'", "(-4, -4)")) + bytes(128),
    "a shape of truths": header(described("'<f8'", "(True, True)")) + bytes(8),
    "a shape of floats": header(described("'<f8'", "(1.0,)")) + bytes(8),
    "a shape of text": header(described("'<f8'", "'1'")) + bytes(8),
    "a shape of 1,000 dimensions": header(described("'<f8'", f"({'1,' * 1000})")) + bytes(8),
    "a shape of 0 and 2^62": header(described("'<f8'", f"(0, {1 << 62})")),
    "a number of 9,000 digits": header(described("'<f8'", f"({'9' * 9000},)")),
    "texts of 2^29 characters": header(described(f"'<U{1 << 29}'", "()")),
    "nothings of 2^31 bytes": header(described("'|V2147483647'", "()")),
    "nothings of 0 bytes": header(described("'|V0'", f"({1 << 40},)")),
    "texts of 0 characters": header(described("'<U0'", f"({1 << 40},)")),
    "Python objects": header(described("'|O'", "(1,)")) + b"\x80\x04N.",
    "objects within a record": header(described("[('a', '<i4'), ('b', 'O')]", "(1,)")) + bytes(12),
    "a record of itself": header(described("[('a', [('b', [('c', '<i4')])])]", "(1,)")) + bytes(4),
    "a record of 10,000 fields": header(described("[" + "('a','i4')," * 700 + "]", "(1,)")) + bytes(4),
    "a subarray of 2^40": header(described(f"('<f8', ({1 << 40},))", "(1,)")) + bytes(8),
    "dates": header(described("'<M8[ns]'", "(1,)")) + bytes(8),
    "an unknown type": header(described("'<q99'", "(1,)")) + bytes(8),
    "no type": header(described("None", "(1,)")) + bytes(8),
    "code in the header": header(b"__import__('os').system('touch canary')\n"),
    "code in the shape": header(described("'<f8'", "(__import__('os').system('touch canary'),)")),
    "code in the type": header(described("__import__('os').getcwd()", "(1,)")),
    "a header of brackets": header(b"(" * 9000 + b"\n"),
    "a header of nested lists": header(b"[" * 90 + b"]" * 90 + b"\n"),
    "a header of minus signs": header(b"-" * 9000 + b"1\n"),
    "a header of additions": header(b"1" + b"+1" * 4000 + b"\n"),
    "a header of bad indentation": header(b"  x\n y\n"),
    "a header of zeros": header(bytes(118)),
    "a header of 4 GB": header(b"x", b"\x02\x00", 0xFFFFFFFF),
    "a header of 60 kB": header(described("'<f8'", "(1,)") + b" " * 60000),
    "a header in UTF-8": header("{'descr': '<f8', 'é': 1}".encode(), b"\x03\x00"),
    "an unknown version": header(b"x", b"\x09\x09"),
    "no header": b"\x93NUMPY",
    "no array": b"hello",
    "nothing": b"",
    "less data than the shape": header(described("'<f8'", "(100,)")) + bytes(8),
    "NaN": npy(np.full((4, 3), np.nan)),
    "infinity": npy(np.full((4, 3), np.inf)),
    "large numbers": npy(np.full((4, 3), 1e300)),
    "complex numbers": npy(np.zeros((4, 3), np.complex128)),
    "truths": npy(np.zeros((4, 3), bool)),
    "one number": npy(np.array(1.0)),
    "no numbers": npy(np.zeros((0, 3))),
    "half precision": npy(np.zeros((4, 3), np.float16)),
    "text": npy(np.array("x" * 100_000)),
    "control characters": npy(np.array("\x1b[2J\n::error::x\ufffe")),
    "whole numbers beyond all indices": npy(np.full((4, 3), (1 << 63) - 1)),
}
"""Arrays that are none, by what they hold."""


_NUMBERED = [f"{number}.npy" for number in range(250)]


def zipped(members: dict[str, bytes], method: int = zipfile.ZIP_STORED) -> bytes:
    """A zip archive."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", method) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return stream.getvalue()


def _patched(data: bytes, field: int, value: bytes) -> bytes:
    """An archive with another value in every entry of its directory, and beside it where the local header has it."""
    changed, place = bytearray(data), 0
    while (place := data.find(b"PK\x01\x02", place)) >= 0:
        changed[place + field : place + field + len(value)] = value
        place += 4
    return bytes(changed)


def _end_patched(data: bytes, field: int, value: bytes) -> bytes:
    place = data.rfind(b"PK\x05\x06") + field
    return data[:place] + value + data[place + len(value) :]


@functools.cache
def _archives() -> dict[str, bytes]:
    small = npz(ARRAYS)
    zeros, large = header(described("'|u1'", f"({400 << 20},)")), 400 << 20
    packed = {"a.npy": zeros + bytes(20 << 20)}
    return {
        "400 MB of zeros": shared_zip(zeros, large, ["a.npy"]),
        "20 MB of zeros as bzip2": zipped(packed, zipfile.ZIP_BZIP2),
        "20 MB of zeros as lzma": zipped(packed, zipfile.ZIP_LZMA),
        "400 MB that claim to be 1 kB": shared_zip(zeros, large, ["a.npy"], claimed=1000),
        "arrays that overlap": shared_zip(header(described("'|u1'", f"({16 << 20},)")), 16 << 20, _NUMBERED),
        "600 MB of zeros": shared_zip(zeros, 600 << 20, ["a.npy"]),
        "5,000 entries": zipped({f"{number}.npy": b"" for number in range(5000)}),
        "70,000 entries": zipped({f"{number}.npy": b"" for number in range(70000)}),
        "names that lead out": zipped({"../../victim.txt": b"x", "../version.npy": npy(np.array("x")), "/etc/x": b""}),
        "names with control characters": zipped({"\x1b[2J\n::error::\ufffe.npy": npy(np.zeros(1))}),
        "a name of 60,000 characters": zipped({"x" * 60_000: npy(np.zeros(1))}),
        "a name of a suffix": zipped({".npy": npy(np.zeros(1))}),
        "the same name twice": small[:-22] + small,
        "an unknown compression": _patched(small, 10, struct.pack("<H", 99)),
        "an encrypted entry": _patched(small, 8, struct.pack("<H", 1)),
        "a later version": _patched(small, 6, struct.pack("<H", 99)),
        "a claimed size of 4 GB": _patched(small, 24, struct.pack("<I", 0xFFFFFFFE)),
        "a claimed size of 0": _patched(small, 24, struct.pack("<I", 0)),
        "a packed size of 4 GB": _patched(small, 20, struct.pack("<I", 0xFFFFFFFE)),
        "another checksum": _patched(small, 16, struct.pack("<I", 1)),
        "an entry before the file": _patched(small, 42, struct.pack("<I", 0xFFFFFFF0)),
        "an entry within another": _patched(small, 42, struct.pack("<I", 4)),
        "a directory before the file": _end_patched(small, 16, struct.pack("<I", 0xFFFFFFF0)),
        "a directory of 4 GB": _end_patched(small, 12, struct.pack("<I", 0xFFFFFFF0)),
        "a comment beyond the end": _end_patched(small, 20, struct.pack("<H", 0xFFFF)),
        "several disks": _end_patched(small, 4, struct.pack("<H", 7)),
        "no directory": small[:-22],
        "only a directory": small[-22:],
        "an archive within": zipped({"a.npy": small, "version.npy": small}),
        "an empty archive": zipped({}),
        "a folder": zipped({"a.npy/": b"", "version.npy/": b""}),
        "gzip": b"\x1f\x8b" + zlib.compress(bytes(1000)),
        "xz": lzma.compress(bytes(100_000)),
        "nothing": b"",
        "PK": b"PK",
        "zip64 fields of 2^63": small[:-22] + b"PK\x06\x06" + b"\xff" * 52 + small[-22:],
    }


def fixtures() -> list[Hostile]:
    """Arrays and archives through all readers of archives in turn; the most dangerous through each."""
    return [*_of_headers(), *_of_archives(), *_of_captures(), *_of_bundles()]


def _of_headers() -> Iterator[Hostile]:
    arrays = [name for name, reader in _READERS.items() if reader not in ("gaussians", "pickle")]
    for number, (title, content) in enumerate(HEADERS.items()):
        yield Hostile(f"{title} in an npy", FILES, "npy", "array.npy", {"array.npy": content})
        file = zipped({f"{name}.npy": content for name in _MEMBERS})
        for name in dict.fromkeys(("plain.npz", arrays[number % len(arrays)])):
            yield Hostile(f"{title} in {name}", FILES, _READERS[name], name, {name: file})
        codes = {f"tracking/00000_00/{name}.npy": content for name in ("exp", "jawpose", "globalpose", "cam", "shape")}
        yield Hostile(f"{title} in a code folder", "emica", "tracking:emica", "tracking", codes)


def _of_archives() -> Iterator[Hostile]:
    names = list(_READERS)
    for number, (title, content) in enumerate(_archives().items()):
        for name in dict.fromkeys(("plain.npz", names[number % len(names)], names[(number + 3) % len(names)])):
            yield Hostile(f"{title} as {name}", FILES, _READERS[name], name, {name: content})


def _of_captures() -> Iterator[Hostile]:
    """Parts of a capture with one array that is wrong."""
    arrays = {"intrinsics", "world_to_camera", "expression", "joint_rotations", "landmarks", "torso_to_camera"}
    for number, name in enumerate(sorted(arrays)):
        for title in list(HEADERS)[number::6]:
            content = zipped({f"{name}.npy": HEADERS[title]})
            yield Hostile(
                f"{title} as {name}", RUN, "capture", "capture", {"capture/tracking.npz": content}, refused=True
            )


def _of_bundles() -> Iterator[Hostile]:
    """MediaPipe's bundle with archives that lie."""
    for title, content in _archives().items() if BUNDLE in FILES_BY_NAME else ():
        if len(content) < 1 << 21:
            yield Hostile(f"{title} as a bundle", FILES, "landmark-networks", BUNDLE, {BUNDLE: content}, True)
