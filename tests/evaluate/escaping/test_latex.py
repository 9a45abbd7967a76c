"""LaTeX: only commands of our table occur, braces and formulas are balanced, and pdfTeX has every letter."""

from __future__ import annotations

import re

import pytest
from hypothesis import given

from evaluate.escaping.latex import COMMANDS, latex_text
from tests.support.hostile_names import NATURAL, TEXTS, patient

KNOWN = {command for value in COMMANDS.values() for command in re.findall(r"\\(?:[a-zA-Z]+|.)", value)}
T1 = set(
    "ĂăĄąĆćČčĎďĐđĘęĚěĞğĹĺĽľŁłŃńŇňŊŋŐőŔŕŘřŚśŞşŠšŢţŤťŮůŰűŸŹźŻżŽžĲĳİıŒœĀāĒēĪīŌōŪū"
    "ĈĉĊċĔĕĖėĜĝĠġĢģĤĥĨĩĬĭĮįĴĵĶķĻļŅņŎŏŖŗŜŝŨũŬŭŲųŴŵŶŷ"
)
"""Letters of Latin Extended-A that LaTeX declares for the T1 encoding (t1enc.dfu)."""


@patient
@given(TEXTS)
def test_only_our_commands_occur(text: str) -> None:
    source = latex_text(text)
    assert set(re.findall(r"\\(?:[a-zA-Z]+|.)", source)) <= KNOWN
    bare = re.sub(r"\\(?:[a-zA-Z]+|.)", "", source)
    assert not re.search(r"[&%#_~^\\\n\t\0-\x1f\x7f-\xa0]", bare)
    assert bare.count("$") % 2 == 0
    depth = 0
    for brace in re.findall(r"[{}]", bare):
        depth += 1 if brace == "{" else -1
        assert depth >= 0
    assert depth == 0
    assert all(letter.isascii() or "\xa1" <= letter <= "\xff" or letter in T1 for letter in source)


@patient
@given(TEXTS)
def test_nothing_of_a_name_is_in_a_formula(text: str) -> None:
    formulas = re.findall(r"(?<!\\)\$(.*?)(?<!\\)\$", re.sub(r"\\\$", "", latex_text(text)))
    assert set(formulas) <= {value[1:-1] for value in COMMANDS.values() if value.startswith("$")}


def test_special_characters_are_escaped() -> None:
    assert latex_text("-1.5 [-2.0, +3]* paper-v1 Ämter ☃") == "$-$1.5 {[}$-$2.0, +3]{*} paper-v1 Ämter ?"
    assert latex_text("50% of #1 & {a_b} ~ ^ \\ $") == (
        r"50\% of \#1 \& \{a\_b\} \textasciitilde{} \textasciicircum{} \textbackslash{} \$"
    )
    assert latex_text("a -- b ``c'' ?`") == "a -{}- b `{}`c'{}' ?{}`"
    assert latex_text("$\\write18{id}$") == r"\$\textbackslash{}write18\{id\}\$"


@pytest.mark.parametrize(
    ("name", "printed"),
    [
        ("Nguyễn", "Nguyên"),
        ("e\u0301", "é"),
        ("Łukasz ſħ", "Łukasz ??"),
        ("张三", "??"),
        ("👩\u200d🦰", "??"),
        ("a\u0323", "a"),
    ],
)
def test_letters_that_the_fonts_lack(name: str, printed: str) -> None:
    assert latex_text(name) == printed


@pytest.mark.parametrize("name", [name for name in NATURAL if re.fullmatch(r"[\w/() '\-,=.]*", name, re.ASCII)])
def test_ordinary_text_is_kept(name: str) -> None:
    assert latex_text(name).replace("\\_", "_") == name
