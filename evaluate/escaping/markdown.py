"""Text in Markdown: CommonMark with GitHub's tables, strikethrough, links and formulas."""

from __future__ import annotations

import re

from ggavatar.text.names import displayable

_MARKUP = re.compile(r"[\\`*_\[<~|]|&(?=#?\w+;)")
_BLOCK = re.compile(r"^(?:#{1,6}(?=\s|$)|[-+](?=\s|$)|>|=+$|-+$|-(?=[-\s]+$)|\d{1,9}[.)](?=\s|$))")
_LINK = re.compile(r"\b(https?|ftp|mailto|xmpp):|\b(www)\.", re.IGNORECASE)


def markdown_text(text: str) -> str:
    """The text for a cell, a heading or a list item: it ends none of them and starts no block, link or formula."""
    line = _MARKUP.sub(r"\\\g<0>", displayable(text))
    line = _BLOCK.sub(lambda found: f"{found[0][:-1]}\\{found[0][-1]}", line)
    line = _LINK.sub(lambda found: f"{found[0][:-1]}\\{found[0][-1]}", line)
    # GitHub finds formulas after it has removed backslashes; its documentation says to put the dollar into an element.
    return line.replace("$", "<span>$</span>")
