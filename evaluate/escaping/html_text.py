"""Text in HTML."""

from __future__ import annotations

from html import escape

from ggavatar.text.names import displayable


def html_text(text: str) -> str:
    """The text for the content of an element or for an attribute in quotes, in which it starts neither."""
    return escape(displayable(text), quote=True)
