"""Fonts of the figures: DejaVu Sans, which comes with matplotlib, and installed ones for scripts that it lacks."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Iterator
from functools import lru_cache

import matplotlib
from matplotlib import font_manager

MAIN = "DejaVu Sans"
FALLBACKS = (
    "Noto Sans CJK JP",
    "Noto Sans CJK SC",
    "Noto Sans JP",
    "Noto Sans SC",
    "Noto Sans KR",
    "Source Han Sans",
    "WenQuanYi Micro Hei",
    "PingFang SC",
    "Hiragino Sans",
    "Apple SD Gothic Neo",
    "Microsoft YaHei",
    "Yu Gothic",
    "Malgun Gothic",
    "Noto Sans Devanagari",
    "Noto Sans Thai",
    "Noto Emoji",
    "Segoe UI Symbol",
    "Apple Symbols",
)
"""Families of Linux, macOS and Windows with letters of East and South Asia and symbols."""


@lru_cache(maxsize=1)
def font_families() -> tuple[str, ...]:
    """DejaVu Sans and those of `FALLBACKS` that are installed."""
    installed = set(font_manager.get_font_names())
    return MAIN, *(name for name in FALLBACKS if name in installed)


@contextlib.contextmanager
def our_fonts() -> Iterator[None]:
    """Figures are drawn in our fonts, without TeX whatever the user's matplotlibrc says; a missing glyph is a box."""
    with matplotlib.rc_context({"font.family": list(font_families()), "text.usetex": False}), warnings.catch_warnings():
        warnings.filterwarnings("ignore", r"Glyph .* missing from", UserWarning)
        yield
