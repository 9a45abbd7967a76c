"""Archives of arrays with malformed headers and bombs: numpy's many errors become one. Reference: numpy's own files."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import numpy as np
import pytest

from ggavatar.errors import InputError
from ggavatar.io.npz import npz_headers, read_npy, read_npz, write_npz
from tests.support.measured import costs


def npy(header: bytes, data: bytes = bytes(200), version: bytes = b"\1\0") -> bytes:
    """An npy file with any header."""
    length = len(header).to_bytes(2 if version == b"\1\0" else 4, "little")
    return b"\x93NUMPY" + version + length + header + data


def described(descr: str, shape: str = "(3,)") -> bytes:
    return f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}".encode()


HEADERS = {
    "tokens without end": b"('",
    "brackets without end": b"(" * 5000,
    "brackets in brackets": b"[" * 150 + b"]" * 150,
    "indentation": b"  x\n y",
    "no dictionary": b"[1, 2]",
    "a call": b"__import__('os').system('id')",
    "empty": b"",
    "zero bytes": bytes(40),
    "no type": described("''"),
    "a type of nothing": described("()"),
    "a type in a type": described("(('<f8', (2, -3)), 'x')"),
    "a list of nothing": described("[]"),
    "a list of one": described("[('a',)]"),
    "numbers as a type": described("5"),
    "objects": described("'|O'"),
    "objects in records": described("[('a', '|O')]"),
    "a huge text": described("'<U99999999999999'"),
    "a text too long": described("'|S2147483647'"),
    "a negative shape": described("'<f8'", "(-1,)"),
    "a shape of truths": described("'<f8'", "(True,)"),
    "a shape of texts": described("'<f8'", "('a',)"),
    "no shape": described("'<f8'", "5"),
    "a shape of 401 digits": described("'<f8'", f"({'9' * 401},)"),
    "a shape of 5000 digits": described("'<f8'", f"({'9' * 5000},)"),
    "many axes": described("'<f8'", f"({'1,' * 100})"),
    "texts of no characters": described("'|S0'", "(1000000000000,)"),
    "a shape larger than the file": described("'<f8'", "(1000,)"),
    "a dictionary of other keys": b"{'a': 1}",
    "half a character": b"{'descr': '\xff\xfe'}",
}


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("version", [b"\1\0", b"\2\0", b"\3\0", b"\t\t"])
@pytest.mark.parametrize("name", HEADERS)
def test_malformed_headers(name: str, version: bytes, tmp_path: Path) -> None:
    content = npy(HEADERS[name], version=version)
    (tmp_path / "x.npy").write_bytes(content)
    with zipfile.ZipFile(tmp_path / "x.npz", "w") as archive:
        archive.writestr("a.npy", content)
    for read, file in ((read_npz, "x.npz"), (npz_headers, "x.npz"), (lambda path: read_npy(path, 1 << 20), "x.npy")):
        with pytest.raises(InputError, match=r"x\.np[yz]: ") as caught:
            read(tmp_path / file)
        assert len(str(caught.value)) < 600


def test_what_numpy_writes_is_read(tmp_path: Path) -> None:
    arrays = {
        "numbers": np.arange(6.0).reshape(2, 3),
        "fortran": np.asfortranarray(np.arange(6, dtype=np.int16).reshape(2, 3)),
        "texts": np.array(["ab", ""]),
        "no text": np.array(""),
        "nothing": np.zeros((0, 4), bool),
        "one": np.float32(2),
    }
    np.savez_compressed(tmp_path / "numpy.npz", **arrays)
    write_npz(tmp_path / "ours.npz", arrays)
    for file in ("numpy.npz", "ours.npz"):
        found = read_npz(tmp_path / file)
        for name, array in arrays.items():
            np.testing.assert_array_equal(found[name], array)
    np.save(tmp_path / "one.npy", arrays["numbers"])
    np.testing.assert_array_equal(read_npy(tmp_path / "one.npy", 1000), arrays["numbers"])


def test_bombs(tmp_path: Path) -> None:
    """Half a gigabyte of zeros in 0.5 MB is the most that is unpacked, once."""
    zeros = np.zeros(1 << 24)
    buffer = io.BytesIO()
    np.save(buffer, zeros)
    for name, count in (("much", 3), ("more", 5)):
        with zipfile.ZipFile(tmp_path / f"{name}.npz", "w", zipfile.ZIP_DEFLATED) as archive:
            for number in range(count):
                archive.writestr(f"{number}.npy", buffer.getvalue())
    much, more = costs("ggavatar.io.npz", "read_npz", [tmp_path / "much.npz", tmp_path / "more.npz"])
    assert much.message is None and much.peak < 1000 and much.seconds < 10
    assert more.message and "unpacks to 640 MiB, the limit is 512 MiB" in more.message and more.peak < 1000
