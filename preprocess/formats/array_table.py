"""Arrays of one frame as a tracker or its user saved them: other names, no batch axis or one too many, lists."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ggavatar.errors import InputError
from preprocess.formats.tracking_record import MAX_MAGNITUDE

Assume = Callable[[str], None]
"""Called with every assumption that reading a file makes, for the report."""


@dataclass(frozen=True)
class ArrayTable:
    """The arrays of a dictionary, found by any of their names and brought to one shape.

    Attributes:
        path: The file, for messages.
        values: Arrays, lists or numbers by name.
        assume: Receives what was assumed.
        batched: Whether the format stores a leading axis of size 1.
    """

    path: Path
    values: Mapping[str, Any]
    assume: Assume
    batched: bool = True

    def name_of(self, names: Sequence[str]) -> str | None:
        """The first of the names that is in the table."""
        return next((name for name in names if name in self.values), None)

    def array(self, names: Sequence[str], *shapes: tuple[int | None, ...]) -> Float[np.ndarray, "..."]:
        """The array under one of the names as float64, in the first of the shapes that it fits.

        Args:
            names: The format's own name first, then other spellings of it.
            *shapes: Possible shapes without a batch axis; None fits any size.

        Raises:
            InputError: No such array, or it fits none of the shapes.
        """
        name = self.name_of(names)
        found = None if name is None else _numbers(self.values[name])
        if name is None or found is None:
            raise InputError(
                f"{self.path}: expected an array {names[0]!r} of shape {self._shapes(shapes)}, found "
                f"{'none' if name is None else type(self.values[name]).__name__}; track the frame again"
            )
        for shape in shapes:
            fitted = self._fitted(found, shape)
            if fitted is not None:
                if name != names[0]:
                    self.assume(f"{name!r} is read as {names[0]!r}")
                return fitted
        raise InputError(
            f"{self.path}: expected {name!r} of shape {self._shapes(shapes)}, found {found.shape}; track the frame "
            "again"
        )

    def table(self, names: Sequence[str]) -> ArrayTable | None:
        """The dictionary under one of the names, or None."""
        name = self.name_of(names)
        inside = None if name is None else self.values[name]
        return ArrayTable(self.path, inside, self.assume, self.batched) if isinstance(inside, Mapping) else None

    def _fitted(self, found: np.ndarray, shape: tuple[int | None, ...]) -> np.ndarray | None:
        usual = found.ndim == len(shape) + 1 and found.shape[0] == 1 if self.batched else found.ndim == len(shape)
        if usual and _fits(found.shape[found.ndim - len(shape) :], shape):
            return found.reshape(found.shape[found.ndim - len(shape) :])
        kept = [size for size in found.shape if size != 1]
        wanted = [size for size in shape if size != 1]
        if len(kept) < len(wanted) and wanted == [None] and found.size == 1:
            kept = [1]
        if not _fits(kept, wanted):
            return None
        if self.batched or found.ndim > len(shape) + 1:
            self.assume("the arrays have another batch axis than the tracker's own files")
        sizes = iter(kept)
        return found.reshape([1 if size == 1 else next(sizes) for size in shape])

    def _shapes(self, shapes: Sequence[tuple[int | None, ...]]) -> str:
        lead = ["1"] if self.batched else []
        texts = [
            "(" + ", ".join([*lead, *("any" if size is None else str(size) for size in shape)]) + ")"
            for shape in shapes
        ]
        return " or ".join(texts)


def _fits(found: Sequence[int], wanted: Sequence[int | None]) -> bool:
    return len(found) == len(wanted) and all(want in (None, size) for want, size in zip(wanted, found, strict=True))


def _numbers(value: object) -> np.ndarray | None:
    """An array of numbers as float64, those that no portrait has as NaN so that nothing overflows; or None."""
    if isinstance(value, list | tuple | int | float) and not isinstance(value, bool):
        try:
            value = np.array(value)
        except (TypeError, ValueError, OverflowError):
            return None
    if not isinstance(value, np.ndarray) or value.dtype.kind not in "fiu" or value.size > 1 << 22:
        return None
    numbers = value.astype(np.float64)
    numbers[~(np.abs(numbers) < MAX_MAGNITUDE)] = np.nan
    return numbers
