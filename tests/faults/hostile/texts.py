"""Text files: recordings as CSV, numbers in lines, meshes as OBJ, that are huge, odd, or formulas."""

from __future__ import annotations

from collections.abc import Iterator

from tests.faults.hostile.bases import FILES
from tests.faults.hostile.fixture import Hostile
from tests.faults.hostile.samples import recording


def _recordings() -> dict[str, bytes]:
    valid = recording(".csv")
    first, rows = valid.split(b"\r\n", 1)
    row = rows.split(b"\r\n")[0]
    code = row.split(b",")[0]
    cell = b",0.5"
    return {
        "a field of 20 MB": first + b'\r\n"' + b"x" * (20 << 20) + b'"' + cell * 53,
        "a quote that does not end": first + b'\r\n"' + row * 1000,
        "a million columns": first + b",x" * 1_000_000 + b"\r\n" + row,
        "a million rows of nothing": first + b"\r\n" * 1_000_000,
        "a million rows": first + b"\r\n" + b"\r\n".join([b"x,1"] * 1_000_000),
        "the same column twice": first + b",JawOpen\r\n" + row + b",1",
        "numbers of 1e999": valid.replace(b"0.5", b"1e999"),
        "numbers of words": valid.replace(b"0.", b"nan"),
        "numbers in Arabic digits": valid.replace(b"0.", "٠.".encode()),
        "numbers of a million digits": first + b"\r\n" + row.replace(b"0.", b"9" * 1_000_000 + b".", 1),
        "numbers with underscores": valid.replace(b"0.", b"1_0."),
        "formulas": first + b"\r\n" + code + b",=cmd|' /C touch canary'!A0" + cell * 52,
        "a time of 99:99:99": valid.replace(code, b"99:99:99:999.999999"),
        "a time of a million digits": valid.replace(code, b"9" * 1_000_000, 1),
        "a time that does not end": valid.replace(code, b"0:" * 100_000, 1),
        "zero bytes": valid.replace(b"0.", b"\0."),
        "UTF-16": valid.decode().encode("utf-16"),
        "Latin-1": valid + b"\xff\xfe\xe9",
        "carriage returns only": valid.replace(b"\r\n", b"\r"),
        "semicolons": valid.replace(b",", b";"),
        "control characters": first + b",\x1b[2J\x07\r\n" + row + b",1",
        "names only": first,
        "blanks": b" " * 1_000_000,
        "commas": b"," * 5_000_000,
        "quotes": b'"' * 1_000_000,
        "nothing": b"",
    }


_NUMBERS = {
    "words": b"a b c",
    "a line of 20 MB": b"1 " * 10_000_000,
    "1e999": b"1e999 " * 16,
    "NaN": b"nan " * 16,
    "no UTF-8": b"\xff\xfe\xfd",
    "a number of a million digits": b"9" * 1_000_000,
    "zeros": bytes(1000),
    "nothing": b"",
}


def fixtures() -> list[Hostile]:
    """Recordings, and the text files of other trackers."""
    return list(_fixtures())


def _fixtures() -> Iterator[Hostile]:
    for title, data in _recordings().items():
        yield Hostile(f"{title} as a recording", FILES, "recording", "take.csv", {"take.csv": data})
    for title, data in _NUMBERS.items():
        for name in ("flame/exp/00001.txt", "flame/jaw/00001.txt", "transforms.json"):
            files = {f"tracking/{name}": data}
            yield Hostile(f"{title} as {name}", "insta", "tracking:insta", "tracking", files)
