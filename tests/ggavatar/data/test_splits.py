"""Train/test rules, against their plain definitions."""

from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ggavatar.data.splits import split_frames, split_name
from ggavatar.errors import InputError

frame_lists = st.lists(st.integers(0, 10_000), min_size=2, max_size=900, unique=True).map(sorted)


@given(frame_lists, st.sampled_from(["every-20th", "every-2", "last-1", "ratio-0.5"]))
def test_disjoint_complete_and_ascending(frames, rule):
    split = split_frames(frames, rule)
    assert sorted(split.train + split.test) == frames
    assert list(split.train) == sorted(split.train) and list(split.test) == sorted(split.test)
    assert split.train and split.test


def test_rules_by_hand():
    frames = list(range(100, 200))
    assert split_frames(frames, "every-20th").test == (100, 120, 140, 160, 180)
    assert split_frames(frames, "last-30").test == tuple(range(170, 200))
    assert split_frames(frames, "ratio-0.8").train == tuple(range(100, 180))
    assert split_name("file:a/b.json") == "file" and split_name("last-350") == "last-350"


@pytest.mark.parametrize("rule", ["last-350", "last-500", "last-100"])
def test_too_short_clips_are_refused(rule):
    with pytest.raises(InputError, match=r"100 frames are too few.*last-20"):
        split_frames(range(100), rule)


@pytest.mark.parametrize(
    "rule",
    ["", "every", "every-1", "every-x", "last-0", "last-2.5", "ratio-1", "ratio-nan", "first-5", "-", "every--5"],
)
def test_unknown_rules(rule):
    with pytest.raises(InputError, match="expected one of"):
        split_frames(range(100), rule)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ('{"train": [0, 1], "test": [2]}', None),
        ('{"train": [0, 1], "test": [1]}', "both lists"),
        ('{"train": [0, 11], "test": [1]}', r"\[11\]"),
        ('{"train": [], "test": [1]}', "found none"),
        ('{"train": [true], "test": [1]}', "to list frames"),
        ('{"train": [0]}', "expected JSON"),
        ("[[[[", "not valid JSON"),
        ('{"train": 5, "test": 6}', "expected JSON"),
    ],
)
def test_files(tmp_path, content, message):
    path = tmp_path / "split.json"
    path.write_text(content)
    if message is None:
        assert split_frames(range(10), f"file:{path}").test == (2,)
        assert json.loads(content)["train"] == list(split_frames(range(10), f"file:{path}").train)
    else:
        with pytest.raises(InputError, match=message):
            split_frames(range(10), f"file:{path}")


def test_missing_file(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        split_frames(range(10), f"file:{tmp_path / 'absent.json'}")
