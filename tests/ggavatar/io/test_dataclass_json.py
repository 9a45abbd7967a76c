"""Plain data to dataclasses and back; every wrong name and type is refused with a way out."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import Literal

import pytest

from ggavatar.errors import InputError, nearest
from ggavatar.io.dataclass_json import from_plain, override, to_plain


@dataclass(frozen=True)
class Inner:
    size: int = 3


@dataclass(frozen=True)
class Config:
    rate: float = 0.1
    count: int = 2
    mode: Literal["a", "b"] = "a"
    on: bool = True
    name: str = "x"
    pairs: tuple[tuple[float, float], ...] = ((0.5, 1.0),)
    limit: int | None = None
    inner: Inner = field(default_factory=Inner)
    free: dict[str, int] = field(default_factory=dict)


def test_round_trip_through_json() -> None:
    config = Config(rate=1e-15, pairs=((0.25, 0.5), (1.0, 2.0)), limit=4, inner=Inner(7), free={"k": 1})
    assert from_plain(Config, json.loads(json.dumps(to_plain(config))), "test") == config


def test_override_parses_each_type() -> None:
    changed = override(
        Config(), ["rate=2", "count=5", "mode=b", "on=false", "name=y", "limit=null", "pairs=[[1, 2]]"], "test"
    )
    assert changed == Config(rate=2.0, count=5, mode="b", on=False, name="y", pairs=((1.0, 2.0),))
    assert type(changed.rate) is float


@pytest.mark.parametrize(
    ("assignment", "message"),
    [
        ("raet=1", "did you mean rate"),
        ("count=1.5", "expected int"),
        ("on=1", "expected bool"),
        ("mode=c", "one of a, b"),
        ("count=true", "expected int"),
        ("rate", "name=value"),
        ("rate=-1", "at least 0"),
        ("rate=NaN", "at least 0"),
        ("count=-3", "at least 0"),
        ('inner={"sise": 1}', "did you mean size"),
        ("pairs=[[1, 2, 3]]", "expected"),
    ],
)
def test_wrong_assignments_are_refused(assignment: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        override(Config(), [assignment], "test")


def test_nearest_is_silent_when_nothing_is_close() -> None:
    assert nearest("zzz", ["rate", "count"]) == ""
