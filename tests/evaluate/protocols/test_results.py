"""Stored results: whatever a field of metrics.json holds instead of ours, reading says so or the result is whole."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from evaluate.protocols.results import read_results, restore_frames, write_results
from ggavatar.errors import InputError
from ggavatar.io.json_files import read_json
from tests.support.damaged_files import ODD_VALUES
from tests.support.evaluations import evaluation

MADE = evaluation("Anna", "ggavatar")
FIELDS = sorted(MADE.as_dict())


@pytest.mark.parametrize("field", FIELDS)
def test_a_field_of_another_type_is_refused_or_harmless(field: str, tmp_path: Path) -> None:
    write_results(MADE, tmp_path)
    path, content = tmp_path / "metrics.json", read_json(tmp_path / "metrics.json")
    refused = 0
    for value in (*ODD_VALUES, [[1]], ["a", "a"], "x" * 100_000, {"mse": "x"}, {"mse": [True]}, {"": {}}, 1.5):
        path.write_text(json.dumps({**content, field: value}))
        try:
            found = read_results(tmp_path)
        except InputError as error:
            refused += 1
            assert "metrics.json" in str(error) and len(str(error)) < 1000
            continue
        json.dumps(found.as_dict(), allow_nan=False)
        hash(found.seed), [f"{value:.3f}" for column in found.values.values() for value in column if value is not None]
    assert refused > 0


def test_a_changed_value_is_noticed(tmp_path: Path) -> None:
    """Results of version 0.1 have no seal and are taken as they are."""
    write_results(MADE, tmp_path)
    path = tmp_path / "metrics.json"
    text = path.read_text()
    assert read_results(tmp_path) == MADE
    path.write_text(text.replace('"ssim": [0.9, 0.92]', '"ssim": [0.9, 0.98]'))
    assert path.read_text() != text
    with pytest.raises(InputError, match=r"metrics\.json: changed since it was written"):
        read_results(tmp_path)
    plain: dict[str, Any] = json.loads(text)
    del plain["content_sha256"]
    path.write_text(json.dumps(plain))
    assert read_results(tmp_path) == MADE


def test_the_table_of_frames_is_restored(tmp_path: Path) -> None:
    write_results(MADE, tmp_path)
    path = tmp_path / "per_frame.csv"
    before = path.read_bytes()
    assert not restore_frames(MADE, tmp_path)
    for damaged in (before[:-4], before.replace(b"9", b"8"), b"\xff"):
        path.write_bytes(damaged)
        assert restore_frames(MADE, tmp_path) and path.read_bytes() == before
    path.unlink()
    assert restore_frames(MADE, tmp_path) and path.read_bytes() == before
