"""What the doctor and the preparation have said about a capture, as sentences."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import groupby
from pathlib import Path
from typing import Any

from ggavatar.errors import InputError
from ggavatar.io.json_files import read_json

REPORT = "doctor.json"
MOST = 12
"""Sentences of a kind that are shown."""
MOST_RANGES = 8


def findings(folder: Path) -> tuple[list[str], str]:
    """The doctor's findings on a capture, and what to say if there are none."""
    if not (folder / REPORT).exists():
        return [], f"not examined yet: run ggavatar-doctor {folder}"
    try:
        listed = read_json(folder / REPORT)["findings"]
        found = [_sentence(item) for item in listed]
    except (InputError, KeyError, TypeError, AttributeError):
        return [], f"{REPORT} is damaged: run ggavatar-doctor {folder}"
    return _shortened(found), "the doctor found nothing"


def _sentence(item: Mapping[str, Any]) -> str:
    flag = f" ({item['flag']})" if item.get("flag") else ""
    return f"{item['severity']}: {item['message']}{flag}"


def dropped_frames(dropped: Iterable[Mapping[str, Any]]) -> list[str]:
    """The frames that were left out, a sentence for every reason."""
    numbers: dict[str, list[int]] = {}
    for item in dropped:
        numbers.setdefault(str(item.get("reason", "left out")), []).append(int(item.get("frame", -1)))
    return _shortened([f"{reason}: {ranges(found)}" for reason, found in numbers.items()])


def ranges(numbers: Iterable[int]) -> str:
    """Numbers in words, neighbors joined: 3-5, 9."""
    ordered = sorted(set(numbers))
    runs = [[number for _, number in run] for _, run in groupby(enumerate(ordered), lambda item: item[1] - item[0])]
    texts = [f"{run[0]}" if len(run) == 1 else f"{run[0]}-{run[-1]}" for run in runs]
    more = f" and {len(texts) - MOST_RANGES} more" if len(texts) > MOST_RANGES else ""
    return ", ".join(texts[:MOST_RANGES]) + more


def _shortened(texts: list[str]) -> list[str]:
    return texts if len(texts) <= MOST else [*texts[:MOST], f"… and {len(texts) - MOST} more"]
