"""Head models that may not be passed on: what an export that contains one asks of its user."""

from __future__ import annotations

from pathlib import Path

from ggavatar.errors import InputError
from ggavatar.head.model import HeadModel

LICENSED_HEADS = ("flame",)
"""Families of heads whose arrays may not be passed on without their owners' consent."""


def is_licensed(head: HeadModel) -> bool:
    """Whether the arrays of a head are somebody's property."""
    return head.version.startswith(LICENSED_HEADS)


def check_license(source: Path, head: HeadModel, what: str, allowed: bool) -> None:
    """Refuse to pass on a licensed head model unless its user says so.

    Args:
        source: The avatar, for the message.
        head: The head model that `what` would contain.
        what: What is written, such as "page".
        allowed: Whether --include-head-model was given.
    """
    if is_licensed(head) and not allowed:
        raise InputError(
            f"{source}: the {what} would contain the template, the bases and the weights of the head model "
            f"{head.version!r}, whose license does not let you pass them on; add --include-head-model if yours does, "
            f"or if the {what} stays with you"
        )
