"""Text in figures: matplotlib draws every name as text, in titles, labels and legends.

Also covers `evaluate/figures/fonts.py`.
"""

from __future__ import annotations

import io
import warnings

import matplotlib
import pytest
from hypothesis import given, settings
from matplotlib import cbook
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text

from evaluate.escaping.figure_text import figure_text
from evaluate.figures.fonts import MAIN, font_families, our_fonts
from evaluate.figures.text import text_coverage
from ggavatar.text.names import displayable
from tests.support.hostile_names import HOSTILE, NATURAL, TEXTS, patient


@patient
@given(TEXTS)
def test_matplotlib_finds_no_formula(text: str) -> None:
    """Its own rule decides, and gives the text that it would draw."""
    drawn, is_math = Text(text=figure_text(text))._preprocess_math(figure_text(text))
    assert is_math is False
    assert drawn.replace("\u200b", "") == displayable(text)
    assert not cbook.is_math_text(figure_text(text))


@pytest.mark.parametrize("name", [*HOSTILE, *NATURAL])
def test_every_name_is_drawn_and_is_in_the_legend(name: str) -> None:
    with our_fonts():
        figure = Figure(figsize=(2, 2))
        FigureCanvasAgg(figure)
        axes = figure.subplots()
        axes.plot([1, 2], label=figure_text(name) or "x")
        axes.set_title(figure_text(name))
        handles, labels = axes.get_legend_handles_labels()
        figure.legend(handles, labels)
        figure.savefig(io.BytesIO(), format="png")
    assert len(labels) == 1


def test_the_users_settings_start_no_tex_and_a_missing_glyph_is_no_warning() -> None:
    with matplotlib.rc_context({"text.usetex": True, "font.family": "serif"}), warnings.catch_warnings():
        warnings.simplefilter("error")
        with our_fonts():
            assert matplotlib.rcParams["text.usetex"] is False
            assert matplotlib.rcParams["font.family"] == list(font_families())
            assert text_coverage("\U0001f9d1", 14.0).max() > 0
    assert font_families()[0] == MAIN


@settings(patient, max_examples=40)
@given(TEXTS)
def test_captions_on_images_are_one_line(text: str) -> None:
    covered = text_coverage(text, 12.0)
    assert covered.shape[0] == text_coverage("x", 12.0).shape[0]
