"""Help pages: real defaults, every flag in a group, examples that parse; what was typed is checked in one line.

Also covers `ggavatar/cli/typed.py` and `ggavatar/cli/training_help.py`. The parser itself is the reference: what it
accepts must pass the checks before it.
"""

from __future__ import annotations

import importlib.metadata
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import pytest
from tyro.conf import Positional, UseAppendAction, arg

from ggavatar.cli import training_help
from ggavatar.cli.flags import flags_of
from ggavatar.cli.page import CommandPage, parse
from ggavatar.errors import InputError
from ggavatar.training import registry
from website.command_pages import PAGES


@dataclass(frozen=True)
class Toy:
    """Options with one of each kind."""

    source: Positional[Path]
    """What is read."""
    output: Annotated[Path, arg(aliases=["-o"], metavar="DIR")]
    """Folder to write; it is made."""
    size: int | None = None
    """Size, px; that of the source if not given."""
    rate: float = 0.5
    """Rate."""
    kind: Literal["red", "green"] | None = None
    """A color."""
    names: tuple[str, ...] = ()
    """Names."""
    set: UseAppendAction[tuple[str, ...]] = ()
    """A setting."""
    fast: bool = False
    """Be fast."""
    video: bool = True
    """Write a video."""


TOY = CommandPage("toy", Toy, "Makes toys.", (("toy a -o b", "a toy"),), {"all": tuple(Toy.__dataclass_fields__)[1:]})


@pytest.mark.parametrize("name", sorted(PAGES))
def test_every_flag_is_in_one_group_and_nothing_says_none(name: str) -> None:
    page = PAGES[name]
    grouped = [flag.field for members in page.grouped().values() for flag in members]
    assert sorted(grouped) == sorted(flag.field for flag in flags_of(page.options))
    text = "\n".join(page.lines(100))
    assert "None" not in text and "listed above" not in text and "(default: )" not in text
    assert all(flag.text for flag in flags_of(page.options)), "every flag says what it does"
    assert max(map(len, page.lines(100))) <= 130, "only examples may be wider than asked"


@pytest.mark.parametrize("name", sorted(PAGES))
def test_a_page_has_three_examples_that_the_command_accepts(name: str) -> None:
    page = PAGES[name]
    assert len(page.examples) == 3
    for line, purpose in page.examples:
        program, *arguments = shlex.split(line)
        assert program == name and purpose
        if arguments == ["runs/alice", "--webcam"]:
            continue  # the value that it may go without is added by the command
        assert isinstance(parse(page, arguments), page.options)


def test_defaults_are_those_of_this_computer(monkeypatch: pytest.MonkeyPatch) -> None:
    """30,000 steps on a GPU and 6,000 on a CPU: `ggavatar/training/plan.py`."""
    for device, steps in (("cuda", "30,000"), ("cpu", "6,000")):
        monkeypatch.setattr(training_help, "likely_device", lambda found=device: found)
        assert any(f"(default: {steps} " in line for line in PAGES["ggavatar-train"].lines(1000))


def test_methods_are_listed_with_their_variants_below_them() -> None:
    lines = training_help.method_lines()[1:]
    assert [line.split()[0] for line in lines] == list(registry.names())
    assert sum(not line.startswith("   ") for line in lines) < len(lines)


def test_help_and_version_end_with_code_0(capsys: pytest.CaptureFixture[str]) -> None:
    for flag in ("--help", "-h", "--version"):
        with pytest.raises(SystemExit) as caught:
            parse(TOY, ["a", flag])
        assert caught.value.code == 0
    shown = capsys.readouterr().out
    assert shown.startswith("usage: toy SOURCE -o DIR [options]") and "(default: 0.5)" in shown
    assert f"toy {importlib.metadata.version('ggavatar')}" in shown


@pytest.mark.parametrize(
    ("typed", "wanted"),
    [
        ("a -o b", Toy(Path("a"), Path("b"))),
        ("a -ob --fast --no-video", Toy(Path("a"), Path("b"), fast=True, video=False)),
        ("--output=b a --rate -3 --size=4", Toy(Path("a"), Path("b"), rate=-3.0, size=4)),
        ("a -o b --names x y --set p=1 --set q=2", Toy(Path("a"), Path("b"), names=("x", "y"), set=("p=1", "q=2"))),
        ("--set p=1 a -o b --kind green", Toy(Path("a"), Path("b"), set=("p=1",), kind="green")),
        ("-o b -- a", Toy(Path("a"), Path("b"))),
    ],
)
def test_what_the_parser_accepts_passes(typed: str, wanted: Toy) -> None:
    assert parse(TOY, typed.split()) == wanted


@pytest.mark.parametrize(
    ("typed", "said"),
    [
        ("a -o b --ratee 1", "unknown flag --ratee (did you mean --rate?); see toy --help"),
        ("a -o b --kind gren", "--kind gren: expected one of red, green (did you mean green?)"),
        ("a -o b --kind None", "--kind None: expected one of red, green"),
        ("a -o b --size big", "--size big: expected a whole number, found 'big'"),
        ("a -o b --size", "--size: expected N after it, found nothing"),
        ("a", "expected -o DIR (folder to write), found none; the command is: toy SOURCE -o DIR [options]"),
        ("-o b", "expected SOURCE (what is read), found none; the command is: toy SOURCE"),
        ("a b -o c", "b: expected no further argument; the command is: toy"),
        ("--names a -o b", "expected SOURCE"),
    ],
)
def test_a_mistake_is_one_line_with_what_is_expected(typed: str, said: str) -> None:
    with pytest.raises(InputError) as caught:
        parse(TOY, typed.split())
    assert str(caught.value).startswith(said) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("program", "typed", "said"),
    [
        ("ggavatar-train", "a gaussian_avatar -o b", "did you mean gaussian_avatars?"),
        ("ggavatar-train", "a -o b --backend tritn", "did you mean triton?"),
        ("ggavatar-sweep", "a -o b --methods ggavatr", "did you mean ggavatar?"),
        ("ggavatar-prep", "a -o b --format vhp", "did you mean vhap?"),
        ("ggavatar-eval", "a --protocol papr", "did you mean paper?"),
        ("ggavatar-demo", "-o b --background buzy", "did you mean busy?"),
    ],
)
def test_names_are_checked_before_anything_is_loaded(program: str, typed: str, said: str) -> None:
    with pytest.raises(InputError, match=said.replace("?", r"\?")):
        parse(PAGES[program], typed.split())
