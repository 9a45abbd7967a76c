"""Texts of the panel: HTML whose every word is escaped, since names come from files; viser renders none as Markdown."""

from __future__ import annotations

from collections.abc import Sequence

from evaluate.escaping.html_text import html_text

STYLE = "padding: 0 0.75em 0.5em; font-size: 0.8em; line-height: 1.45; overflow-wrap: anywhere"


def lines(*texts: str) -> str:
    """Texts as HTML, one below the other; empty ones are left out."""
    inner = "".join(f"<div>{html_text(text)}</div>" for text in texts if text)
    return f'<div style="{STYLE}">{inner}</div>'


def bullets(title: str, texts: Sequence[str], otherwise: str) -> str:
    """A titled list as HTML, or what is said when it is empty."""
    if not texts:
        return lines(otherwise)
    items = "".join(f"<li>{html_text(text)}</li>" for text in texts)
    heading = f"<b>{html_text(title)}</b>" if title else ""
    return f'<div style="{STYLE}">{heading}<ul style="margin: 0.2em 0; padding-left: 1.4em">{items}</ul></div>'
