"""Frame numbers in the names of per-image codes, such as `frame_0001`, `video2_0001` or EMOCA's `000001_000`."""

from __future__ import annotations

import re
from collections.abc import Sequence

from ggavatar.errors import InputError

_DIGITS = re.compile(r"\d{1,9}")
_FRAME_AND_FACE = re.compile(r"^\d+_\d{2,3}$")


def frame_names(source: object, names: Sequence[str]) -> tuple[dict[int, str], tuple[str, ...]]:
    """Names by frame number, ascending, and notes on what was assumed.

    Names with the same text around their numbers: the first number that differs between them is the frame's; a second
    one that differs is that of a face or camera in the frame, of which the lowest is taken. Other names are numbered by
    their last number.

    Args:
        source: The folder, for messages.
        names: File names without suffix, all different.

    Raises:
        InputError: A name has no number, or several have the same.
    """
    groups = [[int(text) for text in _DIGITS.findall(name)] for name in names]
    bare = next((name for name, numbers in zip(names, groups, strict=True) if not numbers), None)
    if bare is not None:
        raise InputError(f"{source}: expected a frame number in every name, found {bare!r:.60}; rename it")
    frame, face = _positions(names, groups)
    ordered = sorted(zip(groups, names, strict=True), key=lambda item: (item[0][frame], item[0][face]))
    chosen: dict[int, str] = {}
    for numbers, name in ordered:
        chosen.setdefault(numbers[frame], name)
    if len(chosen) < len(names) and face == frame:
        raise InputError(f"{source}: expected every frame number once, found one several times; rename the codes")
    lost = len(names) - len(chosen)
    return chosen, (f"of several faces or cameras in a frame the first is taken ({lost} others)",) if lost else ()


def _positions(names: Sequence[str], groups: Sequence[Sequence[int]]) -> tuple[int, int]:
    """Which number of a name is the frame's and which is the face's; the same if there is no such second number."""
    if len({_DIGITS.sub("#", name) for name in names}) > 1:
        return -1, -1
    differing = [place for place in range(len(groups[0])) if len({numbers[place] for numbers in groups}) > 1]
    if not differing:
        return (0, 0) if _FRAME_AND_FACE.match(names[0]) else (-1, -1)
    return differing[0], differing[1] if len(differing) > 1 else differing[0]
