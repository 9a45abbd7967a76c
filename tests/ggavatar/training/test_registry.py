"""A file in methods/ is a method: names, descriptions, variants, and a new file without any other edit."""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys
import types
from collections.abc import Iterator
from pathlib import Path

import pytest

from ggavatar.errors import InputError
from ggavatar.plugins.entry_points import METHODS
from ggavatar.training import registry
from ggavatar.training.provenance import method_package_of
from tests.support.plugin_packages import install

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


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty folder of installed packages; modules named `of_a_test…` are forgotten afterwards."""
    monkeypatch.syspath_prepend(str(tmp_path))
    yield tmp_path
    for name in [name for name in sys.modules if name.startswith("of_a_test")]:
        del sys.modules[name]


def test_a_method_of_another_package_is_one_of_ours(site: Path) -> None:
    install(site, "dots", {"of_a_test.dots": STRANGER}, {METHODS: {"dots": "of_a_test.dots"}}, version="1.5")
    assert registry.names()["dots_slow"] == "dots, slow" and "of_a_test.dots" not in sys.modules
    slow = registry.load("dots_slow")
    assert slow.config().rate == 0.1 and str(slow.plugin) == "method 'dots' of the package dots 1.5"
    assert method_package_of("dots") == {"method_package": {"name": "dots", "version": "1.5"}}
    assert method_package_of("ggavatar") == {}


def test_the_help_lists_it_and_names_what_is_broken(site: Path) -> None:
    """A new process, whose packages are found by PYTHONPATH."""
    install(site, "dots", {"of_a_test_dots": STRANGER, "of_a_test_open": '"""Open."""\ndef ('}, {})
    (site / "dots-1.dist-info" / "entry_points.txt").write_text(
        f"[{METHODS}]\ndots = of_a_test_dots\nopen = of_a_test_open\ngone = of_a_test_gone\nggavatar_plus = x\n"
    )
    code = (
        "from ggavatar.cli.training_help import method_lines; import sys; print(*method_lines(), sep=chr(10)); "
        "sys.exit('torch' in sys.modules)"
    )
    paths = os.pathsep.join((str(site), str(Path(__file__).parents[3])))
    shown = subprocess.run(
        [sys.executable, "-c", code], env={**os.environ, "PYTHONPATH": paths}, capture_output=True, text=True
    )
    assert shown.returncode == 0, shown.stderr
    listed = [" ".join(line.split()) for line in shown.stdout.splitlines()]
    assert "dots A stranger that only exists in this test." in listed
    assert any(line.startswith("ggavatar GGAvatar") for line in listed)
    notes = [line for line in shown.stdout.splitlines() if line.startswith("note: ")]
    assert len(notes) == 3
    for words in ("'open' of the package dots 1 is left out: its source", "no module of_a_test_gone", "of this name"):
        assert sum(words in note for note in notes) == 1, notes


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("import no_such_module_of_a_test\nConfig = VARIANTS = {}", "failed when it was imported: ModuleNotFoundError"),
        ("VARIANTS = {}", "found no Config, build"),
    ],
)
def test_a_broken_method_is_refused_where_it_is_used_only(source: str, message: str, site: Path) -> None:
    install(site, "dots", {"of_a_test_dots": source}, {METHODS: {"dots": "of_a_test_dots"}})
    assert {"dots", "ggavatar"} <= set(registry.names())
    assert registry.load("ggavatar").plugin is None
    with pytest.raises(InputError, match=message):
        registry.load("dots")


def test_names_of_variants_clash_too(site: Path) -> None:
    """`ggavatar_without` with a variant `lbs` would be an ablation of ours."""
    source = STRANGER.replace('"slow"', '"lbs"')
    install(site, "a", {"of_a_test_a": source}, {METHODS: {"ggavatar_without": "of_a_test_a"}})
    assert "ggavatar has a method 'ggavatar_without_lbs' too" in registry.problems()["ggavatar_without"]
    with pytest.raises(InputError, match="package a 1 is left out"):
        registry.load("ggavatar_without")
    assert registry.load("ggavatar_without_lbs").plugin is None


def test_a_run_names_the_package_that_is_missing(site: Path) -> None:
    package = {"name": "dots\x1b[2J", "version": "1.5"}
    with pytest.raises(InputError, match=r"^run: expected the package dots\S*2J 1.5, whose method dots trained it"):
        registry.load_as_trained("dots", package, Path("run"))
    with pytest.raises(InputError, match=r"unknown method 'dots'.*Install the package"):
        registry.load_as_trained("dots", None, Path("run"))
