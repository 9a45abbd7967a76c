"""JSON files: round trip, and every way in which one can be wrong ends in one message that names the file."""

from __future__ import annotations

from pathlib import Path

import pytest

from ggavatar.errors import InputError
from ggavatar.io.json_files import read_json, write_json


def test_round_trip(tmp_path: Path) -> None:
    values = {"name": "Zoë", "numbers": [1, 2.5, None], "nested": {"empty": {}}}
    write_json(tmp_path / "a.json", values)
    assert read_json(tmp_path / "a.json") == values


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"{", "not valid JSON"),
        (b"[" * 100_000, "not valid JSON"),
        (b'{"a": NaN}', "NaN is not a JSON number"),
        (b'{"a": "\xff"}', "not valid JSON"),
        (b"[]", "expected a JSON object, found list"),
        (b'{"a": "' + bytes(200) + b'"}', "expected a JSON file of at most 100 bytes, found 209 bytes"),
    ],
)
def test_damage_is_one_message(content: bytes, message: str, tmp_path: Path) -> None:
    path = tmp_path / "damaged.json"
    path.write_bytes(content)
    with pytest.raises(InputError, match=message) as caught:
        read_json(path, limit=100 if b"\0" in content else 1 << 20)
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
