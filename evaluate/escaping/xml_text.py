"""Text in XML."""

from __future__ import annotations

from ggavatar.text.names import displayable


def xml_text(text: str) -> str:
    """The text with only characters that XML 1.0 allows (section 2.2); its lines stay apart.

    The library that writes the elements escapes `<` and `&`.
    """
    return "\n".join(map(displayable, text.splitlines()))
