"""Training and test frames: the split rules common in the literature, each giving two explicit lists."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ggavatar.errors import InputError
from ggavatar.io.json_files import read_json


@dataclass(frozen=True)
class Split:
    """Source frame numbers to train on and to test on, ascending and disjoint."""

    train: tuple[int, ...]
    test: tuple[int, ...]


RULES = "every-20th, last-350, last-500, ratio-0.8, file:PATH"


def split_name(rule: str) -> str:
    """The name of a rule's split in capture.json: the rule itself, but `file` for `file:PATH`."""
    return "file" if rule.startswith("file:") else rule


def split_frames(frames: Sequence[int], rule: str) -> Split:
    """Split a clip's frames by a rule.

    Args:
        frames: Source frame numbers, ascending.
        rule: `every-N` (every N-th frame from the first is a test frame; N = 20 in GGAvatar Sec. 5), `last-N` (the last
            N frames; 350 in INSTA, 500 in FlashAvatar), `ratio-R` (the first fraction R is for training, the rest for
            testing) or `file:PATH` (JSON with lists `train` and `test`).

    Raises:
        InputError: The rule is unknown, its file is invalid, or the clip is so short that a list would be empty.
    """
    kind, _, value = rule.partition(":" if rule.startswith("file:") else "-")
    if kind == "file":
        return _read_split(frames, Path(value))
    number = _number(rule, kind, value)
    count = len(frames)
    if kind == "every":
        test = range(0, count, int(number))
    elif kind == "last":
        test = range(max(0, count - int(number)), count)
    else:
        test = range(round(count * number), count)
    tested = set(test)
    split = Split(tuple(frames[k] for k in range(count) if k not in tested), tuple(frames[k] for k in test))
    if not split.train or not split.test:
        raise InputError(
            f"split {rule}: {count} frames are too few, {_empty(split)} would be empty; {_advice(kind, count)}"
        )
    return split


def _number(rule: str, kind: str, value: str) -> float:
    """The number of a rule; `InputError` if the rule is unknown or does not allow the number."""
    try:
        number = float(value.removesuffix("th"))
    except ValueError:
        number = -1.0
    valid = {
        "every": number >= 2 and number.is_integer(),
        "last": number >= 1 and number.is_integer(),
        "ratio": 0 < number < 1,
    }
    if not valid.get(kind, False):
        raise InputError(f"split {rule!r}: expected one of {RULES}")
    return number


def _empty(split: Split) -> str:
    return "the training list" if not split.train else "the test list"


def _advice(kind: str, count: int) -> str:
    if kind == "last":
        return f"use a longer video or --split last-{max(1, count // 5)}, ratio-0.8 or every-20th"
    return "use a longer video"


def _read_split(frames: Sequence[int], path: Path) -> Split:
    """Explicit lists from a JSON file; unknown frames are an error, frames in neither list are not used."""
    data = read_json(path)
    try:
        train, test = sorted(set(data["train"])), sorted(set(data["test"]))
    except (KeyError, TypeError) as error:
        raise InputError(
            f'{path}: expected JSON like {{"train": [0, 1], "test": [2]}}, found something else ({error!r})'
        ) from error
    known = set(frames)
    for name, listed in (("train", train), ("test", test)):
        if not listed or not all(type(n) is int and n in known for n in listed):
            unknown = [n for n in listed if type(n) is not int or n not in known][:5]
            raise InputError(
                f"{path}: expected {name!r} to list frames of the clip ({frames[0]} … {frames[-1]}), found "
                f"{unknown or 'none'}"
            )
    if set(train) & set(test):
        raise InputError(
            f"{path}: frames {sorted(set(train) & set(test))[:5]} are in both lists; remove each from "
            "'train' or from 'test'"
        )
    return Split(tuple(train), tuple(test))
