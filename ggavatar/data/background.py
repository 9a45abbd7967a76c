"""Background colors on the command line."""

from __future__ import annotations

from ggavatar.errors import InputError

BACKGROUNDS = {"white": (1.0, 1.0, 1.0), "black": (0.0, 0.0, 0.0)}


def parse_background(text: str) -> tuple[float, float, float]:
    """An sRGB color in [0, 1] from `white`, `black` or `R,G,B`; `InputError` for any other text."""
    if text in BACKGROUNDS:
        return BACKGROUNDS[text]
    try:
        red, green, blue = (float(part) for part in text.split(","))
    except ValueError as error:
        raise InputError(
            f"--background: expected white, black or R,G,B, found {text!r}; for example --background 0,1,0"
        ) from error
    if not all(0 <= part <= 1 for part in (red, green, blue)):
        raise InputError(f"--background: expected three numbers from 0 to 1 separated by commas, found {text!r}")
    return red, green, blue
