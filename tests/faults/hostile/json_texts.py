"""JSON that is deep, huge, not JSON, or says what cannot be; in every file of JSON that is read."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from tests.faults.hostile.bases import FILES, RUN
from tests.faults.hostile.fixture import Hostile, Repeated
from tests.faults.hostile.samples import FILES as FILES_BY_NAME

TEXTS: dict[str, bytes | Repeated] = {
    "100,000 brackets": b"[" * 100_000,
    "100,000 closed brackets": b"[" * 100_000 + b"]" * 100_000,
    "100,000 objects in each other": b'{"a":' * 100_000 + b"1" + b"}" * 100_000,
    "1,000 lists in each other": b'{"a":' + b"[" * 900 + b"]" * 900 + b"}",
    "a number of 401 digits": b'{"version": ' + b"9" * 401 + b"}",
    "a number of a million digits": b'{"version": ' + b"9" * 1_000_000 + b"}",
    "a fraction of a million digits": b'{"version": 0.' + b"9" * 1_000_000 + b"}",
    "1e999": b'{"version": 1e999}',
    "1e-999999999": b'{"version": 1e-999999999}',
    "an exponent of a million digits": b'{"version": 1e' + b"9" * 1_000_000 + b"}",
    "NaN": b'{"version": NaN}',
    "Infinity": b'{"version": -Infinity}',
    "null": b"null",
    "a list": b"[]",
    "a number": b"1",
    "text": b'"text"',
    "nothing": b"",
    "blanks": b" " * 1_000_000,
    "an empty object": b"{}",
    "zeros": bytes(1000),
    "UTF-16": '{"a": 1}'.encode("utf-16"),
    "UTF-8 with a mark": b"\xef\xbb\xbf{}",
    "Latin-1": '{"subject": "é"}'.encode("latin-1"),
    "half of a surrogate pair": b'{"subject": "\\ud800", "schema": "\\udfff"}',
    "an escaped zero": b'{"subject": "\\u0000", "schema": "\\u0000"}',
    "two documents": b"{}{}",
    "a comment": b"{} // x",
    "a comma too many": b'{"a": 1,}',
    "a key without quotes": b"{a: 1}",
    "the same key 100,000 times": b"{" + b",".join([b'"version": 1'] * 100_000) + b"}",
    "a key of a megabyte": b'{"' + b"k" * 1_000_000 + b'": 1}',
    "a text without end": b'{"a": "' + b"x" * 1_000_000,
    "a million escapes": b'{"a": "' + b"\\n" * 1_000_000 + b'"}',
    "20 million lists": Repeated(b'{"frames": [', b"[],", 20_000_000, b"[]]}"),
    "15 million objects": Repeated(b'{"frames": [', b"{},", 15_000_000, b"{}]}"),
    "12 million texts": Repeated(b'{"frames": [', b'"ab",', 12_000_000, b'"ab"]}'),
    "15 million fractions": Repeated(b'{"frames": [', b"1.5,", 15_000_000, b"1.5]}"),
    "30 million numbers": Repeated(b'{"frames": [', b"1,", 30_000_000, b"1]}"),
    "a million keys": b'{"frames": {' + b",".join(b'"%x": 1' % n for n in range(1_000_000)) + b"}}",
    "65 MB": Repeated(b'{"a": "', b"x", 65 << 20, b'"}'),
}
"""Documents, by what they are."""

_SINGLE = {"object.json": "json", "metrics.json": "results", "baseline.json": "baseline", "split.json": "split-file"}
_SINGLE |= {"take.json": "recording"}
_RUN = ("config.json", "split.json", "provenance.json", "checkpoints/step-000000003.json")
_TRACKINGS = ("vhap", "nerface", "nerfblendshape", "imavatar", "insta", "nersemble")

ODD: tuple[Any, ...] = (
    *(None, True, -1, 0, 1.5, 10**30, 10**400, 1e300, -1e300, "", "x", "../../etc/passwd", "/dev/zero", "\0", "9" * 30),
    *("\x1b[2J", "\n::error::x", "\ufffe", "x" * 100_000, [], {}, [[]], [1, "2"], [None], {"": {}}, [10**30] * 3),
    *([0] * 100_000, list(range(-5, 5)), ["a", "a"], [1e308] * 4, {"train": [], "test": []}, [[[[1]]]], "NaN", [True]),
)
"""Values that no field is meant to have."""


def fixtures() -> list[Hostile]:
    """Documents in all files in turn, and odd values in every field of each."""
    return [*_documents(), *_values(), *_paths()]


def _documents() -> Iterator[Hostile]:
    for number, (title, text) in enumerate(TEXTS.items()):
        names = list(_SINGLE)
        for name in dict.fromkeys(("object.json", names[number % len(names)])):
            yield Hostile(f"{title} as {name}", FILES, _SINGLE[name], name, {name: text})
        if len(text) > 1 << 22:
            continue
        yield Hostile(f"{title} as capture.json", RUN, "capture", "capture", {"capture/capture.json": text}, True)
        file = _RUN[number % len(_RUN)]
        yield Hostile(f"{title} as {file}", RUN, "run", "run", {f"run/{file}": text})
        yield Hostile(f"{title} in a journal", RUN, "journal", _JOURNAL, {_JOURNAL: bytes(text) + b"\n{}\n"})


_JOURNAL = "run/metrics/train.jsonl"


def _values() -> Iterator[Hostile]:
    """Every field of a file with odd values in turn, so that each field gets some and each value is in some field."""
    place = 0
    for name, reader in _SINGLE.items():
        content = json.loads(FILES_BY_NAME[name]())
        for key in content:
            for value in ODD[place % 7 :: 7]:
                text = json.dumps(content | {key: value}).encode()
                yield Hostile(f"{value!r:.30} as {key} of {name}", FILES, reader, name, {name: text})
            place += 1


def _paths() -> Iterator[Hostile]:
    """Names of files that lead out of their folder, in data sets that list files."""
    outside = ("../../victim.txt", "/etc/passwd", "/dev/zero", "\\\\server\\share", "file:///etc/passwd", "a\0b", ".")
    for name in (*outside, "x" * 10_000, "../" * 3000, "http://127.0.0.1:9/x.png", "|touch canary", "$(touch canary)"):
        frame = {"timestep_index": 0, "camera_index": 0, "file_path": name, "flame_param_path": name}
        frame |= {"transform_matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}
        text = json.dumps({"frames": [frame], "w": 96, "h": 96, "camera_angle_x": 1.0}).encode()
        files = {"tracking/transforms.json": text}
        yield Hostile(f"{name!r:.40} in a list of frames", "vhap", "tracking:vhap", "tracking", files, True)
        images = {f"{number:05d}.png": None for number in range(3)} | {"transforms.json": text}
        yield Hostile(f"{name!r:.40} in a list of images", "frames", "frames", ".", images)
