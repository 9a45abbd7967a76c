"""A name for every expression coefficient of a head: what it means, or a number."""

from __future__ import annotations

from ggavatar.head.expression_axes import names_without_file
from ggavatar.head.model import HeadModel


def axis_names(head: HeadModel) -> tuple[str, ...]:
    """The name of every expression coefficient; those without a meaning of their own are numbered."""
    count = head.expression_basis.shape[2]
    known = head.expression_names or names_without_file(head.version, count)
    return known or tuple(f"expression_{index + 1}" for index in range(count))
