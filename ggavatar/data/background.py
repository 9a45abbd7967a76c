"""The color behind the person."""

from __future__ import annotations

from ggavatar.errors import InputError

BACKGROUNDS = {"white": (1.0, 1.0, 1.0), "black": (0.0, 0.0, 0.0)}


def parse_background(text: str) -> tuple[float, float, float]:
    """A color from `white`, `black` or `R,G,B` in [0, 1]."""
    if text in BACKGROUNDS:
        return BACKGROUNDS[text]
    try:
        red, green, blue = (float(part) for part in text.split(","))
    except ValueError as error:
        raise InputError(f"--background: expected white, black or R,G,B, found {text!r}") from error
    if not all(0 <= part <= 1 for part in (red, green, blue)):
        raise InputError(f"--background: expected three numbers from 0 to 1, found {text!r}")
    return red, green, blue
