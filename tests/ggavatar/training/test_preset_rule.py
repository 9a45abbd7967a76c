"""A preset changes lengths, rates, budgets and initial values; what a method models, sees and minimizes it leaves."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from ggavatar.training import registry
from ggavatar.training.preset_rule import PRESET_FIELDS, check_preset

METHODS = sorted({registry.load(name).module.__name__.rpartition(".")[2] for name in registry.names()})
PRESETS = ("default", "fast", "paper")

NEVER = ("pose_on", "condition", "alpha_weight", "region_weight", "perceptual_weight", "color_unit", "normals")
"""Fields that decide what is modeled, seen or minimized; each was in a preset once."""


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize("preset", PRESETS)
def test_presets_keep_the_rule(name: str, preset: str) -> None:
    method = registry.load(name)
    plain, chosen = method.module.Config(), method.config(preset)
    for field in dataclasses.fields(plain):
        if field.name in NEVER or field.name.endswith("_weight"):
            assert getattr(plain, field.name) == getattr(chosen, field.name), field.name


@pytest.mark.parametrize("field", NEVER)
def test_a_change_of_the_method_is_refused(field: str) -> None:
    with pytest.raises(ValueError, match=field):
        check_preset("method m, preset fast", ["position_rate", field])


def test_the_registry_applies_the_rule(monkeypatch: pytest.MonkeyPatch) -> None:
    method = registry.load("ggavatar")
    monkeypatch.setitem(method.module.PRESETS, "fast", {"pose_on": "neck"})
    with pytest.raises(ValueError, match="method ggavatar, preset fast"):
        method.config("fast")


def test_every_field_of_the_rule_belongs_to_a_method() -> None:
    known = {field.name for name in METHODS for field in dataclasses.fields(registry.load(name).module.Config)}
    assert {name for kind in PRESET_FIELDS.values() for name in kind} <= known


def test_the_documents_list_every_change() -> None:
    """docs/paper.md names each field that `default` changes in `ggavatar`, with its value."""
    text = (Path(__file__).parents[3] / "docs" / "paper.md").read_text(encoding="utf-8")
    section = text[text.index("## Presets") :]
    changes = registry.load("ggavatar").module.PRESETS["default"]
    listed = {
        line.split("|")[1].strip(" `"): line.split("|")[3].strip() for line in section.splitlines() if "| `" in line
    }
    assert listed == {name: f"`{value!r}`" for name, value in changes.items()}
