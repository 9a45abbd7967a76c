"""Text in workflow commands, the lines `::error title=…::…` in which GitHub reads annotations.

Rules: escapeData and escapeProperty of actions/toolkit, packages/core/src/command.ts.
"""

from __future__ import annotations

from ggavatar.text.names import displayable


def github_message(text: str) -> str:
    """The text for the message of a workflow command; its lines stay apart in the annotation."""
    return "%0A".join(displayable(line).replace("%", "%25") for line in text.splitlines())


def github_property(text: str) -> str:
    """The text for a property of a workflow command, such as `title`."""
    return github_message(text).replace(":", "%3A").replace(",", "%2C")
