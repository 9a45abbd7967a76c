"""JSON files: round trip, and every way in which one can be wrong ends in one message that names the file."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from ggavatar.errors import InputError
from ggavatar.io.json_files import parse_value, read_json, readable_json, sealed, write_json, write_sealed_json
from tests.support.measured import costs


def test_round_trip(tmp_path: Path) -> None:
    values = {"name": "Zoë", "numbers": [1, 2.5, None], "nested": {"empty": {}}}
    write_json(tmp_path / "a.json", values)
    assert read_json(tmp_path / "a.json") == values


def test_every_changed_byte_of_a_sealed_file_is_noticed_or_changes_nothing(tmp_path: Path) -> None:
    """Every bit of the file; reference: the values that were written. A changed name of the seal is a further entry."""
    path, values = tmp_path / "a.json", {"numbers": [1, 2.5, -0.0], "name": "x", "nested": {"empty": {}, "none": None}}
    write_sealed_json(path, values)
    assert read_json(path) == values
    original = path.read_bytes()
    for place in range(8 * len(original)):
        changed = bytearray(original)
        changed[place // 8] ^= 1 << place % 8
        path.write_bytes(changed)
        try:
            found = read_json(path)
        except InputError as error:
            assert "a.json" in str(error)
            continue
        assert {name: found.get(name) for name in values} == values


def test_a_seal_does_not_depend_on_order_and_spacing_and_none_is_needed(tmp_path: Path) -> None:
    """Keys that are numbers, and tuples, are what JSON makes of them."""
    path, values = tmp_path / "a.json", {"b": (1, 2), "a": {1: "x"}}
    path.write_text(json.dumps(dict(reversed(sealed(values).items()))))
    assert read_json(path) == {"a": {"1": "x"}, "b": [1, 2]}
    path.write_text('{"a": 1}')
    assert read_json(path) == {"a": 1}
    path.write_text('{"a": 1, "content_sha256": "00"}')
    with pytest.raises(InputError, match=r"a\.json: changed since it was written"):
        read_json(path)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"{", "not valid JSON"),
        (b"[" * 100_000, "not valid JSON"),
        (b'{"a": NaN}', "NaN is not a JSON number"),
        (b'{"a": "\xff"}', "not valid JSON"),
        (b'{"a": ' * 100_000, "nested too deeply"),
        (b'{"a": -Infinity}', "-Infinity is not a JSON number"),
        (b'{"a": 1e999}', "1e999 is too large"),
        (b'{"a": ' + b"9" * 401 + b"}", "too large for a 64-bit number"),
        (b'{"a": 18446744073709551616}', "too large for a 64-bit number"),
        (b'{"a": ' + b"9" * 5000 + b"}", "too large for a 64-bit number"),
        (b'{"a": 1, "b": 2, "a": 3}', "the name 'a' is there twice"),
        (b'{"a": [' + b"{}," * 4_000_000 + b"0]}", "more values than 512 MiB hold"),
        (b"1", "expected a JSON object, found int"),
        (b"null", "expected a JSON object, found NoneType"),
        (b"\xff\xfe{\x00}\x00", "not valid JSON"),
        (b"[]", "expected a JSON object, found list"),
        (b'{"a": "' + bytes(200) + b'"}', "expected a JSON file of at most 100 bytes, found 209 bytes"),
    ],
)
def test_damage_is_one_message(content: bytes, message: str, tmp_path: Path) -> None:
    path = tmp_path / "damaged.json"
    path.write_bytes(content)
    with pytest.raises(InputError, match=message) as caught:
        read_json(path, limit=100 if bytes(200) in content else 1 << 24)
    assert str(caught.value).count(str(path)) == 1


def test_absent_file_and_folder(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_json(tmp_path / "absent.json")
    with pytest.raises(InputError, match="found a folder"):
        read_json(tmp_path)


def test_nothing_is_written_that_is_not_json(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="JSON"):
        write_json(tmp_path / "a.json", {"a": float("nan")})
    assert not any(tmp_path.iterdir())


def test_readable_json_keeps_letters_and_any_file_name() -> None:
    value = {"Zoë": ["张三", "caf\udce9", "\ud83d\ude00 \\ud800", 1.5]}
    text = readable_json(value)
    assert text.encode() == '{"Zoë": ["张三", "caf\\udce9", "\\ud83d\\ude00 \\\\ud800", 1.5]}'.encode()
    assert json.loads(text)["Zoë"][:2] == parse_value(text)["Zoë"][:2] == ["张三", "caf\udce9"]
    with pytest.raises(ValueError, match="not JSON compliant"):
        readable_json(float("nan"))


def test_what_is_allowed(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    text = '{"a": 18446744073709551615, "b": -1e308, "c": "\\ud83d\\ude00 \\\\ud800 é", "d": {"a": 1}}'
    path.write_bytes(text.encode())
    assert read_json(path) == {"a": 2**64 - 1, "b": -1e308, "c": "😀 \\ud800 é", "d": {"a": 1}}


@pytest.mark.slow
def test_a_large_file_of_small_values_takes_little_memory(tmp_path: Path) -> None:
    """Lists of numbers, objects and texts at the limit of what is accepted, measured in a process of its own."""
    kinds = {"numbers": b"0.5,", "lists": b"[],", "objects": b'{"a":[]},', "texts": b'"ab",', "wide": '"é😀",'.encode()}
    files = []
    for name, part in kinds.items():
        weights = {b",": 64, b"[": 96, b"{": 240, b":": 160, b'"': 16}
        cost = sum(weight * part.count(mark) for mark, weight in weights.items())
        count = min(((1 << 29) - 1000) // cost, ((1 << 26) - 100) // len(part))
        files.append(tmp_path / f"{name}.json")
        files[-1].write_bytes(b'{"a": [' + part * count + b"0]}")
    for found in costs("ggavatar.io.json_files", "read_json", files):
        assert found.message is None and found.seconds < 10 and found.peak < 1000, found
