"""A file in methods/ is a method: names, descriptions, variants, and a new file without any other edit."""

from __future__ import annotations

import dataclasses
import subprocess
import sys
import types
from pathlib import Path

import pytest

from ggavatar.errors import InputError
from ggavatar.training import registry

STRANGER = '''"""A stranger that only exists in this test."""
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Config:
    """Nothing much."""

    rate: float = 0.5
    """A rate."""


VARIANTS: dict[str, dict[str, Any]] = {"slow": {"rate": 0.1}}


def build(config: Config, scene: Any) -> Any:
    """Nothing to build."""
    return config
'''


def test_ablations_of_table_2_are_command_line_names() -> None:
    wanted = {"ggavatar", *(f"ggavatar_without_{what}" for what in ("adjuster", "triplane", "lbs", "initialization"))}
    assert wanted <= set(registry.names())


def test_listing_imports_neither_torch_nor_a_method() -> None:
    code = (
        "import sys; from ggavatar.training import registry; registry.names(); "
        "print('torch' in sys.modules, 'ggavatar.methods.ggavatar' in sys.modules)"
    )
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert shown.stdout.split() == ["False", "False"]


def test_a_new_file_is_a_new_method(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import ggavatar.methods

    (tmp_path / "stranger_in_a_test.py").write_text(STRANGER)
    monkeypatch.setattr(registry, "METHODS_FOLDER", tmp_path)
    monkeypatch.setattr(ggavatar.methods, "__path__", [str(tmp_path)])
    assert registry.names() == {
        "stranger_in_a_test": "A stranger that only exists in this test.",
        "stranger_in_a_test_slow": "stranger_in_a_test, slow",
    }
    slow = registry.load("stranger_in_a_test_slow")
    assert slow.build(slow.config(), None).rate == 0.1
    assert slow.config(assignments=["rate=3"]).rate == 3.0
    del sys.modules["ggavatar.methods.stranger_in_a_test"]


def test_unknown_method_names_the_nearest() -> None:
    with pytest.raises(InputError, match=r"did you mean ggavatar\?"):
        registry.load("gavatar")


@pytest.mark.parametrize("name", sorted(registry.names()))
def test_every_method_is_documented(name: str) -> None:
    method = registry.load(name)
    assert registry.names()[name].strip()
    config = method.config("default")
    assert dataclasses.is_dataclass(config) and method.module.Config.__dataclass_params__.frozen
    source = Path(str(method.module.__file__)).read_text().splitlines()
    for field in dataclasses.fields(config):
        line = next(number for number, text in enumerate(source) if text.startswith(f"    {field.name}: "))
        assert source[line + 1].strip().startswith('"""'), f"{name}: {field.name} has no line under it"


@pytest.mark.parametrize("name", sorted(registry.names()))
def test_every_config_goes_through_json(name: str) -> None:
    method = registry.load(name)
    for preset in ("default", "fast", "paper"):
        config = method.config(preset)
        assert method.config_from(dataclasses.asdict(config), "test") == config


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        (
            'TABLE_NOTES: tuple[str, ...] = ("without rotation of "\n    "harmonics",)',
            ("without rotation of harmonics",),
        ),
        ('TABLE_NOTES = ("a", "b")', ("a", "b")),
        ("OTHER = 1", ()),
        ('COUNT = 2\nTABLE_NOTES = (f"{COUNT} frames",)', ("computed",)),
    ],
)
def test_notes_for_tables_are_read_from_the_source(
    source: str, expected: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "shy.py").write_text(f'"""Shy."""\n{source}\nVARIANTS = {{"more": {{}}}}\n')
    monkeypatch.setattr(registry, "METHODS_FOLDER", tmp_path)
    module = types.ModuleType("shy")
    module.__dict__["TABLE_NOTES"] = ("computed",)
    monkeypatch.setattr(registry, "load", lambda name: registry.Method(name, module, {}))
    assert registry.table_notes("shy") == registry.table_notes("shy_more") == expected
    assert registry.table_notes("unknown") == ()


def test_a_method_without_notes_has_none() -> None:
    assert registry.Method("x", types.ModuleType("x"), {}).notes == ()
