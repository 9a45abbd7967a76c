"""The journal is only appended to: nothing before the checkpoint is rewritten, nothing outside the run is touched."""

from __future__ import annotations

import io
from pathlib import Path

import pytest

from ggavatar.errors import InputError
from ggavatar.training.journal import Journal, read_journal


def test_journal_forgets_what_lies_beyond_the_checkpoint_and_torn_lines(tmp_path: Path) -> None:
    path = tmp_path / "train.jsonl"
    journal = Journal(path, 0)
    for step in (1, 2, 3):
        journal.write({"step": step, "loss": step / 3})
    journal.close()
    inode = path.stat().st_ino
    with path.open("a") as stream:
        stream.write('{"step": 4, "lo')
    again = Journal(path, 2)
    again.write({"step": 3, "loss": 9.0})
    again.close()
    assert read_journal(path) == [{"step": 1, "loss": 1 / 3}, {"step": 2, "loss": 2 / 3}, {"step": 3, "loss": 9.0}]
    assert path.stat().st_ino == inode


def test_it_is_never_emptied_to_be_rewritten(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It used to be: a kill between the truncation and the writing lost every line."""
    path = tmp_path / "train.jsonl"
    lines = "".join(f'{{"step": {step}}}\n' for step in range(1, 200))
    path.write_text(lines)
    plain, modes = io.open, []

    def watched(file: object, mode: str = "r", *arguments: object, **named: object) -> object:
        modes.append(mode)
        return plain(file, mode, *arguments, **named)

    monkeypatch.setattr(io, "open", watched)  # what pathlib opens files with, in write_text too
    Journal(path, 150).close()
    assert modes and not any("w" in mode for mode in modes)
    assert path.read_text() == lines[: lines.index('{"step": 151}')]


def test_links_are_not_followed(tmp_path: Path) -> None:
    (tmp_path / "theirs.txt").write_text("theirs\n")
    (tmp_path / "train.jsonl").symlink_to(tmp_path / "theirs.txt")
    with pytest.raises(InputError, match="found a link"):
        Journal(tmp_path / "train.jsonl", 0)
    assert (tmp_path / "theirs.txt").read_text() == "theirs\n"


@pytest.mark.parametrize(
    "damage", [b"\xff\xfe\n", b"[" * 100_000 + b"\n", b"[]\n", b'{"step": "4"}\n', b'{"step": true}\n']
)
def test_damaged_lines_are_skipped(tmp_path: Path, damage: bytes) -> None:
    path = tmp_path / "train.jsonl"
    path.write_bytes(b'{"step": 1}\n' + damage + b'{"step": 2}\n')
    assert [record["step"] for record in read_journal(path)] == [1, 2]


def test_missing_journal_is_empty(tmp_path: Path) -> None:
    assert read_journal(tmp_path / "none.jsonl") == []
