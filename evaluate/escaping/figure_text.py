"""Text in matplotlib's figures."""

from __future__ import annotations

from ggavatar.text.names import displayable


def figure_text(text: str) -> str:
    """The text for a title, a label or an annotation, in which matplotlib finds no formula (`$…$`).

    Labels that begin with an underscore are left out of legends: a space without width comes before it.
    """
    shown = displayable(text).replace("$", r"\$")
    return f"\u200b{shown}" if shown.startswith("_") else shown
