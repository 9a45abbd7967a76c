"""Plug-ins are listed without being imported; one that cannot be used is named, and the others stay.

The reference is the entry-point specification of the Python Packaging User Guide: packages are folders with a
`.dist-info` as pip writes it.
"""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from ggavatar.errors import InputError
from ggavatar.plugins.entry_points import CAPTURE_FORMATS, METHODS, guarded, listed, own_entry_points, source_of
from tests.support.plugin_packages import install

BROKEN = "import a_module_that_is_not_there\n"


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder of installed packages, searched first."""
    monkeypatch.syspath_prepend(str(tmp_path))
    return tmp_path


def test_a_plugin_is_listed_without_being_imported(site: Path) -> None:
    install(site, "my-package", {"my_plugin.dots": "raise SystemExit(3)"}, {METHODS: {"dots": "my_plugin.dots"}})
    found = listed(METHODS)
    assert str(found.usable["dots"]) == "method 'dots' of the package my-package 1" and not found.problems
    assert source_of("my_plugin.dots") == site / "my_plugin" / "dots.py"
    assert not {"my_plugin", "my_plugin.dots"} & set(sys.modules)


@pytest.mark.parametrize(
    ("source", "message"),
    [
        (
            BROKEN,
            r"^method 'dots' of the package my-package 1: failed when it was imported: ModuleNotFoundError: No .*",
        ),
        ("\n\nvalue = 1 / 0\n", r"ZeroDivisionError: division by zero \(dots_of_a_test.py:3\); update my-package"),
        ("raise SystemExit('stop')", "SystemExit: stop"),
        ("def broken(:", "SyntaxError"),
        ("build = 1\n", r"expected dots_of_a_test to define Config, build, found no Config; update my-package"),
    ],
)
def test_a_broken_plugin_is_one_line_when_it_is_used(source: str, message: str, site: Path) -> None:
    install(site, "my-package", {"dots_of_a_test": source}, {METHODS: {"dots": "dots_of_a_test"}})
    with pytest.raises(InputError, match=message) as raised:
        listed(METHODS).usable["dots"].load("Config", "build")
    assert "\n" not in str(raised.value)
    sys.modules.pop("dots_of_a_test", None)


def test_one_name_in_two_packages_is_nobodys(site: Path) -> None:
    install(site, "a", {}, {METHODS: {"dots": "a.dots", "lines": "a.lines"}})
    install(site, "b", {}, {METHODS: {"dots": "b.dots"}}, version="2")
    found = listed(METHODS)
    assert list(found.usable) == ["lines"]
    with pytest.raises(InputError, match="method 'dots' is left out: a 1 and b 2 both register it; uninstall one"):
        found.require("dots")


def test_a_name_of_ours_stays_ours(site: Path) -> None:
    install(site, "a", {}, {METHODS: {"ggavatar": "a.dots"}, CAPTURE_FORMATS: {"VHAP": "a.x", "flash_avatar": "a.y"}})
    assert "ggavatar has a method of this name" in listed(METHODS, ["ggavatar"]).problems["ggavatar"]
    problems = listed(CAPTURE_FORMATS, own_entry_points(CAPTURE_FORMATS)).problems
    assert "small letters" in problems["VHAP"] and "of this name" in problems["flash_avatar"]


@pytest.mark.parametrize("name", ["../x", "Dots", "1dots", "a b", "my-dots", "x" * 65])
def test_names_that_cannot_be_folders_or_words_are_refused(name: str, site: Path) -> None:
    install(site, "a", {}, {METHODS: {name: "a.dots", "good": "a.good"}})
    found = listed(METHODS)
    assert list(found.usable) == ["good"] and "its author has to rename it" in found.problems[name]


def test_unreadable_metadata_of_a_package_hides_no_other(site: Path) -> None:
    install(site, "good", {}, {METHODS: {"dots": "a.dots"}})
    install(site, "bad", {}, {})
    (site / "bad-1.dist-info" / "entry_points.txt").write_text(f"[{METHODS}]\nno equals sign\n")
    assert list(listed(METHODS).usable) == ["dots"]
    assert "vhap" in own_entry_points(CAPTURE_FORMATS)


def test_sources_that_are_not_there() -> None:
    assert source_of("no_such_package_of_a_test.part") is None and source_of("sys") is None
    assert source_of("ggavatar.errors") == Path(str(sys.modules["ggavatar.errors"].__file__))


def test_what_the_machine_or_the_input_does_is_no_fault_of_the_plugin(site: Path) -> None:
    install(site, "a", {}, {METHODS: {"dots": "a.dots"}})
    plugin = listed(METHODS).usable["dots"]
    with pytest.raises(FileNotFoundError), guarded(plugin, "it read"):
        (site / "none").read_text()
    with pytest.raises(InputError, match=r"^expected a cat$"), guarded(plugin, "it read"):
        raise InputError("expected a cat")
    expected = r"^method 'dots' of the package a 1: failed when it read: ValueError: two lines "
    with pytest.raises(InputError, match=expected), guarded(plugin, "it read"):
        raise ValueError("two\nlines")
