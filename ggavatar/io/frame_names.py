"""Frame numbers in the names of files and folders: one rule for frames, masks, trackings and evaluation.

Names are compared with each other, because one name alone does not say which of its numbers counts the frames:

- Names of one kind share everything but their numbers. A number that is the same in all names (a take, a year, a
  resolution, the `_000` of EMOCA's folders) is part of the name.
- One number that changes is the frame.
- Two that change are frame and camera (`%05d_%02d`, as VHAP and NeRSemble write them), unless one alone already tells
  all names apart: then that one is the frame and the other belongs to it, as a time stamp does.

Positions in a sorted list are never taken for numbers, since a gap would shift everything after it.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from ggavatar.errors import InputError

MAX_DIGITS = 9
"""Longest number that counts frames; longer ones are time stamps."""
MAX_STRAY = 0.1
"""Fraction of names of another kind that is left out; with more it cannot be told which ones are meant."""

_NUMBER = re.compile(r"\d+")
_CAMERA_WORD = re.compile(r"(cam|camera|view)[_-]?$", re.IGNORECASE)
_FRAME_AND_CAMERA = re.compile(r"^\d{4,9}_\d{2,3}$")


T = TypeVar("T")


@dataclass(frozen=True)
class FrameNumbers:
    """Frame numbers of names.

    Attributes:
        numbers: One for each name; None for names that are left out (another camera's, or of another kind).
        notes: What was assumed, in words.
        cameras: Cameras that the names tell apart, ascending; empty if there is only one.
    """

    numbers: tuple[int | None, ...]
    notes: tuple[str, ...] = ()
    cameras: tuple[int, ...] = ()

    def by_number(self, values: Sequence[T]) -> dict[int, T]:
        """What belongs to the names, such as the names themselves, by ascending frame number."""
        found = {number: value for number, value in zip(self.numbers, values, strict=True) if number is not None}
        return dict(sorted(found.items()))


def frame_numbers(names: Sequence[str], source: object, camera: int | None = None) -> FrameNumbers:
    """The frame numbers in names of files or folders without their suffixes.

    Args:
        names: The names, in any order. Names without a number are left out.
        source: Where they are, for messages.
        camera: The camera to use where names tell several apart; None is the first.

    Raises:
        InputError: It cannot be told which number counts the frames, two names have the same one, or there is no such
            camera.
    """
    columns, rows, notes = _largest_kind(names, source)
    if not rows:
        return FrameNumbers((None,) * len(names))
    frame, other = _choose_columns(columns, [names[row] for row in rows], source)
    values, chosen = columns.values[:, frame], np.ones(len(rows), bool)
    cameras: tuple[int, ...] = ()
    if other is not None:
        cameras = tuple(int(value) for value in np.unique(columns.values[:, other]))
        wanted = cameras[0] if camera is None else camera
        if wanted not in cameras:
            raise InputError(
                f"{source}: no camera {wanted} in the names, only {_listed(cameras)}; choose with --camera"
            )
        chosen = columns.values[:, other] == wanted
        given = "" if camera is not None else "; choose another one with --camera"
        notes += (f"the names hold frame and camera: of cameras {_listed(cameras)}, camera {wanted} is used{given}",)
    numbers: list[int | None] = [None] * len(names)
    for row, value, keep in zip(rows, values, chosen, strict=True):
        numbers[row] = int(value) if keep else None
    _require_distinct(numbers, names, source)
    return FrameNumbers(tuple(numbers), notes, cameras)


@dataclass(frozen=True)
class _Columns:
    """The numbers in names of one kind: one row a name, one column a number; and the texts before each column."""

    values: np.ndarray
    before: tuple[str, ...]


def _largest_kind(names: Sequence[str], source: object) -> tuple[_Columns, list[int], tuple[str, ...]]:
    """The names of the commonest kind, their rows, and a note on others."""
    kinds = [_NUMBER.sub("#", name) for name in names]
    counts = Counter(kind for kind in kinds if "#" in kind)
    if not counts:
        return _Columns(np.zeros((0, 0), np.int64), ()), [], ()
    kind, count = counts.most_common(1)[0]
    rest = [name for name, other in zip(names, kinds, strict=True) if "#" in other and other != kind]
    rows = [row for row, other in enumerate(kinds) if other == kind]
    if len(rest) > MAX_STRAY * count:
        raise InputError(
            f"{source}: expected one image per frame with names of one kind, found {names[rows[0]]} and {rest[0]}; "
            "move one kind into a folder of its own"
        )
    found = np.array([[_value(digits) for digits in _NUMBER.findall(names[row])] for row in rows], dtype=object)
    notes = (f"{len(rest)} names of another kind are left out, such as {rest[0]}",) if rest else ()
    return _Columns(found, tuple(kind.split("#")[:-1])), rows, notes


def _value(digits: str) -> int:
    """The number; all that are far too long are the same."""
    return int(digits) if len(digits) <= 30 else 10**30


def _choose_columns(columns: _Columns, names: Sequence[str], source: object) -> tuple[int, int | None]:
    """The column of the frame and that of the camera, None if the names tell no cameras apart."""
    values = columns.values
    changing = [column for column in range(values.shape[1]) if len(set(values[:, column])) > 1]
    if not changing:
        changing = [_column_of_one_name(names[0], values.shape[1])]
    short = [column for column in changing if len(str(max(values[:, column]))) <= MAX_DIGITS]
    if not short:
        raise InputError(
            f"{source}: expected frame numbers of at most {MAX_DIGITS} digits in the names, found {names[0]}; rename "
            "the files to 000000, 000001, …"
        )
    unique = [column for column in short if len(set(values[:, column])) == len(set(names))]
    if unique:
        # Of several that tell all names apart, the one with the smallest range counts the frames.
        return min(unique, key=lambda column: max(values[:, column]) - min(values[:, column])), None
    if len(changing) == 1:
        return changing[0], None
    if len(changing) == 2 and len(short) == 2:
        return _frame_and_camera(columns, (short[0], short[1]))
    raise InputError(
        f"{source}: expected names with one number that changes (the frame) or two (frame and camera), found "
        f"{len(changing)} in {names[0]} … {names[-1]}; rename the files to 000000, 000001, …"
    )


def _column_of_one_name(name: str, count: int) -> int:
    """The frame's column where nothing changes, as in a single name: the last, unless it is `%05d_%02d`."""
    return 0 if count == 2 and _FRAME_AND_CAMERA.match(name) else count - 1


def _frame_and_camera(columns: _Columns, pair: tuple[int, int]) -> tuple[int, int]:
    """Of two columns, the frame's and the camera's.

    The camera's follows the word "cam" or "view", or has fewer values; of two equal ones it is the last.
    """
    words = [column for column in pair if _CAMERA_WORD.search(columns.before[column])]
    if len(words) == 1:
        camera = words[0]
    else:
        sizes = [len(set(columns.values[:, column])) for column in pair]
        camera = pair[0] if sizes[0] < sizes[1] else pair[1]
    return (pair[0] if camera == pair[1] else pair[1]), camera


def _require_distinct(numbers: Sequence[int | None], names: Sequence[str], source: object) -> None:
    seen: dict[int, str] = {}
    for number, name in sorted(zip(numbers, names, strict=True), key=lambda item: item[1]):
        if number is not None and number in seen:
            raise InputError(
                f"{source}: expected one image per frame, found {seen[number]} and {name} for frame {number}; "
                "remove one"
            )
        if number is not None:
            seen[number] = name


def _listed(values: Sequence[int]) -> str:
    shown = ", ".join(map(str, values[:8]))
    return shown if len(values) <= 8 else f"{shown}, … {values[-1]}"
