"""Background colors on the command line of every command: a name, or sRGB from 0 to 1. Does not import torch."""

from __future__ import annotations

import math

from ggavatar.errors import InputError, nearest

Color = tuple[float, float, float]

BACKGROUNDS: dict[str, Color] = {"white": (1.0, 1.0, 1.0), "black": (0.0, 0.0, 0.0)}
EXPECTED = "--background: expected white, black or R,G,B from 0 to 1 (sRGB), such as 0,1,0"


def parse_background(text: str) -> Color:
    """An sRGB color in [0, 1] from `white`, `black` or `R,G,B`.

    Raises:
        InputError: Any other text; for values up to 255 the message has the color to pass instead.
    """
    if text in BACKGROUNDS:
        return BACKGROUNDS[text]
    try:
        red, green, blue = (float(part) for part in text.split(","))
    except ValueError as error:
        raise InputError(f"{EXPECTED}; found {text!r}{nearest(text, BACKGROUNDS)}") from error
    color = red, green, blue
    if not all(math.isfinite(part) and part >= 0 for part in color):
        raise InputError(f"{EXPECTED}; found {text!r}")
    if max(color) <= 1:
        return color
    if max(color) <= 255:
        divided = background_text((red / 255, green / 255, blue / 255))
        raise InputError(f"{EXPECTED}; found {text!r}, which seems to be in 0 to 255; pass --background {divided}")
    raise InputError(f"{EXPECTED}; found {text!r}")


def background_text(color: Color) -> str:
    """A color as text that `parse_background` reads: its name, or its numbers with up to four decimals."""
    for name, known in BACKGROUNDS.items():
        if color == known:
            return name
    return ",".join(f"{part:.4f}".rstrip("0").rstrip(".") for part in color)
