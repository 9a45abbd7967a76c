"""A name for every expression coefficient of a head: its own, those of its family, or numbers."""

from __future__ import annotations

from ggavatar.head.expression_axes import names_without_file
from ggavatar.head.ict import EXPRESSIONS as ICT_AXES
from ggavatar.head.model import HeadModel
from ggavatar.head.procedural.model import procedural_names


def axis_names(head: HeadModel) -> tuple[str, ...]:
    """The name of every expression coefficient; those without a meaning of their own are numbered."""
    count = head.expression_basis.shape[2]
    known = head.expression_names or names_without_file(head.version, count)
    if not known and head.version.startswith("procedural-"):
        known = procedural_names()[0]
    if not known and head.version.startswith("ict-facekit-"):
        known = ICT_AXES
    return tuple(known) if len(known) == count else tuple(f"expression_{index + 1}" for index in range(count))
