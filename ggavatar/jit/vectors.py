"""Triples and quadruples of 16-lane vectors: a column each for sixteen rows."""

from __future__ import annotations

from ggavatar.jit.kernels import inlined
from ggavatar.jit.memory import gather_rows, load_columns_3, load_columns_4
from ggavatar.jit.simd import fma


@inlined
def columns_3(array, first, last):
    """The columns of sixteen consecutive rows of an array [N, 3]; rows beyond `last` repeat it."""
    if first + 15 <= last:
        return load_columns_3(array, first * 3)
    return (
        gather_rows(array, first, last, 3, 0),
        gather_rows(array, first, last, 3, 1),
        gather_rows(array, first, last, 3, 2),
    )


@inlined
def columns_4(array, first, last):
    """The columns of sixteen consecutive rows of an array [N, 4]; rows beyond `last` repeat it."""
    if first + 15 <= last:
        return load_columns_4(array, first * 4)
    a, b = gather_rows(array, first, last, 4, 0), gather_rows(array, first, last, 4, 1)
    return a, b, gather_rows(array, first, last, 4, 2), gather_rows(array, first, last, 4, 3)


@inlined
def dot(a, b):
    """Dot product of two triples of vectors."""
    return fma(a[0], b[0], fma(a[1], b[1], a[2] * b[2]))
