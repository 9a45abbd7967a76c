"""Inert stand-ins for the objects that a pickle may name, and their conversion to plain values and arrays.

Every stand-in only stores what a file says; sizes are checked before anything is allocated. A `Budget`, taken from the
size of the file, bounds what a small file can expand to.
"""

from __future__ import annotations

from collections.abc import Callable
from math import prod
from typing import Any

import numpy as np


class Refused(Exception):
    """A pickle asked for something outside the allow-list."""


MINIMUM_BUDGET, MAXIMUM_BUDGET = 1 << 24, 1 << 29
EXPANSION = 8
MAX_STEPS = 3_000_000
"""Most opcodes of a file: two or three seconds; the pickles of trackers have some hundred."""
MAX_DEPTH = 50
MAX_NODES = 1_000_000
"""Most values that a file may hold when shared parts are written out, so that no message prints forever."""

_ALLOWED_DTYPE_KINDS = frozenset("biufSU")


class Budget:
    """Bytes that the content of a file may still take beyond the file itself, and opcodes that may still run.

    Args:
        size: Size of the unpacked pickle, bytes; the budget is eight times that, and 16 MiB to 512 MiB.
    """

    def __init__(self, size: int) -> None:
        self._remaining = min(max(MINIMUM_BUDGET, EXPANSION * size), MAXIMUM_BUDGET)
        self._steps = MAX_STEPS

    def step(self) -> None:
        """Count one opcode; `Refused` if there are more than `MAX_STEPS`."""
        self._steps -= 1
        if self._steps < 0:
            raise Refused(f"more than {MAX_STEPS} objects")

    def spend(self, count: int) -> None:
        """Take `count` bytes; `Refused` if fewer are left."""
        self._remaining -= count
        if self._remaining < 0:
            raise Refused(
                f"arrays or objects that expand to more than {EXPANSION} times the file, or {MAXIMUM_BUDGET >> 20} MiB"
            )


class DtypeStandIn:
    """A dtype as pickled: `numpy.dtype(code, …)` followed by its state, of which only the byte order matters."""

    def __init__(self, code: object = "", *_: object) -> None:
        text = code.decode("latin1") if isinstance(code, bytes) else code
        if not isinstance(text, str) or len(text) > 8:
            raise Refused("a number type of another kind")
        self._code, self._little = text, False

    def __setstate__(self, state: object) -> None:
        order = state[1] if isinstance(state, tuple) and len(state) > 1 else "="
        if not isinstance(order, str) or order not in ("<", "=", "|"):
            raise Refused("big-endian numbers")
        self._little = order == "<"

    def resolve(self) -> np.dtype[Any]:
        """The dtype; `Refused` unless it is of plain numbers or text."""
        try:
            found = np.dtype(self._code)
        except TypeError as error:
            raise Refused(f"number type {self._code!r}") from error
        if found.kind not in _ALLOWED_DTYPE_KINDS or found.hasobject:
            raise Refused(f"number type {self._code!r}")
        return found.newbyteorder("<") if self._little else found


class ArrayStandIn:
    """An array as pickled: `_reconstruct(…)` followed by (version, shape, dtype, Fortran order, bytes)."""

    def __init__(self, budget: Budget) -> None:
        self._budget = budget
        self._value: np.ndarray | None = None

    def __setstate__(self, state: object) -> None:
        if not isinstance(state, tuple) or len(state) not in (4, 5):
            raise Refused("an array without its contents")
        shape, kind, fortran, data = state[-4:]
        self._value = array_of(self._budget, data, kind, shape, "F" if fortran is True or fortran == 1 else "C")

    def value(self) -> np.ndarray:
        """The array, sharing the bytes of the pickle (read-only)."""
        if self._value is None:
            raise Refused("an array without its contents")
        return self._value


def array_of(budget: Budget, data: object, kind: object, shape: object, order: str) -> np.ndarray:
    """An array over the given bytes; `Refused` if they are not those of the shape and the number type."""
    if isinstance(data, str):
        budget.spend(len(data))
        data = data.encode("latin1")
    if not isinstance(kind, DtypeStandIn) or not isinstance(data, bytes | bytearray):
        raise Refused("an array of Python objects")
    number, sizes = kind.resolve(), checked_sizes(shape)
    if prod(sizes) * number.itemsize != len(data):
        raise Refused(f"an array whose {len(data)} bytes are not those of its shape")
    return np.frombuffer(data, number).reshape(sizes, order="F" if order == "F" else "C")


def checked_sizes(shape: object) -> tuple[int, ...]:
    """The shape as a tuple of whole numbers of 0 or more, at most eight of them; `Refused` otherwise."""
    if not isinstance(shape, tuple | list) or len(shape) > 8:
        raise Refused("an array without a shape")
    if not all(type(size) is int and 0 <= size < 1 << 40 for size in shape):
        raise Refused("an array whose shape is not made of sizes")
    return tuple(shape)


_STATE_KEYS = frozenset({"x", "a", "idxs", "preferred_shape", "shape", "_shape", "data", "indices", "indptr"})


class ObjectStandIn:
    """An object of chumpy or scipy: its attributes, never its behavior."""

    def __init__(self, *_: object) -> None:
        self.state: dict[str, Any] = {}

    def __setstate__(self, state: object) -> None:
        if not isinstance(state, dict):
            raise Refused("an object without attributes")
        self.state = {key: state[key] for key in _STATE_KEYS if key in state}


class SelectStandIn(ObjectStandIn):
    """`chumpy.reordering.Select`: entries of another array."""


class SparseStandIn(ObjectStandIn):
    """`scipy.sparse.csc_matrix`."""


class ClassStandIn:
    """A class that is only ever an argument (numpy.ndarray, object) and must not be called."""

    def __init__(self, *_: object) -> None:
        raise Refused("an array or object created directly")


def check_key(key: object) -> None:
    """Refuse a dictionary key or set entry whose hash is not computed at once, or can be made to be that of others.

    Names and numbers are allowed. Python's hash of an integer is the remainder of 2⁶¹ - 1, so that a hundred thousand
    of its multiples take a minute.
    """
    if key is not None and type(key) not in (str, bytes, int, float, bool):
        raise Refused("a dictionary or set whose keys are not names or numbers")
    if type(key) is int and abs(key) >= 1 << 60:
        raise Refused("a dictionary or set with keys of more than 60 bits")


_SINGLE_TYPES = frozenset({str, bytes, int, float, bool})
_PLAIN_TYPES = (str, bytes, bytearray, int, float, complex, set, frozenset, np.ndarray)


class PlainConverter:
    """Replaces stand-ins by arrays; shared parts are converted once, so a small file cannot expand into a large one.

    Args:
        budget: What the arrays of scipy and chumpy may take.
        resolve: Array of a further stand-in (a tensor), or None if the value is none.
    """

    def __init__(self, budget: Budget, resolve: Callable[[object], np.ndarray | None]) -> None:
        self._budget, self._resolve = budget, resolve
        self._converted: dict[int, tuple[object, Any, int]] = {}
        self._in_progress: set[int] = set()
        self._nodes = 0
        self._remaining_sparse = 4

    def convert(self, value: Any) -> Any:
        """Convert a value to plain content."""
        if value is None or type(value) in _SINGLE_TYPES:
            self._count(1)
            return value
        if id(value) in self._converted:
            _, result, nodes = self._converted[id(value)]
            self._count(nodes)
            return result
        if id(value) in self._in_progress or len(self._in_progress) > MAX_DEPTH:
            raise Refused(f"a structure that contains itself or is nested more than {MAX_DEPTH} deep")
        self._in_progress.add(id(value))
        before = self._nodes
        self._count(1)
        result = self._convert_new(value)
        self._in_progress.discard(id(value))
        self._converted[id(value)] = (value, result, self._nodes - before)
        return result

    def _count(self, nodes: int) -> None:
        self._nodes += nodes
        if self._nodes > MAX_NODES:
            raise Refused(f"a structure of more than {MAX_NODES} values")

    def _convert_new(self, value: Any) -> Any:
        if isinstance(value, ArrayStandIn):
            return value.value()
        if isinstance(value, ObjectStandIn):
            return self._array_of(value)
        if isinstance(value, dict):
            return {key: self.convert(item) for key, item in value.items()}
        if isinstance(value, list | tuple):
            return type(value)(self.convert(item) for item in value)
        tensor = self._resolve(value)
        if tensor is not None:
            return tensor
        if value is not None and not isinstance(value, _PLAIN_TYPES):
            raise Refused(f"{type(value).__name__} where a value is expected")
        return value

    def _array_of(self, value: ObjectStandIn) -> np.ndarray:
        """The array that an object of chumpy or scipy represents."""
        state = {key: self.convert(item) for key, item in value.state.items()}
        if isinstance(value, SparseStandIn):
            self._remaining_sparse -= 1
            if self._remaining_sparse < 0:
                raise Refused("more than four sparse matrices")
            return _sparse_to_dense(state, self._budget)
        if isinstance(value, SelectStandIn):
            source, chosen = _numbers(state["a"]).ravel(), _numbers(state["idxs"], "iu")
            self._budget.spend(chosen.size * source.itemsize)
            entries, shape = source[chosen], state.get("preferred_shape")
            return entries.reshape(checked_sizes(shape)) if isinstance(shape, tuple) else entries
        if not isinstance(state.get("x"), np.ndarray):
            raise Refused("an object of chumpy other than a plain array")
        return state["x"]


def _numbers(value: object, kinds: str = "biuf") -> np.ndarray:
    """A value that must be an array of numbers."""
    if not isinstance(value, np.ndarray) or value.dtype.kind not in kinds:
        raise Refused("a matrix of something else than arrays of numbers")
    return value


def _sparse_to_dense(state: dict[str, Any], budget: Budget) -> np.ndarray:
    """Convert a compressed-column matrix to an array, checking every index."""
    shape = checked_sizes(state.get("_shape", state.get("shape")))
    data, rows = _numbers(state["data"]), _numbers(state["indices"], "iu")
    starts = _numbers(state["indptr"], "iu").astype(np.int64)  # differences of unsigned numbers are never negative
    if len(shape) != 2:
        raise Refused("a sparse matrix without a shape")
    if prod(shape) > 1 << 22 or len(starts) != shape[1] + 1 or data.shape != rows.shape or data.ndim != 1:
        raise Refused(f"a sparse matrix of shape {shape} that does not fit its contents")
    counts = np.diff(starts)
    if (counts < 0).any() or starts[0] != 0 or starts[-1] != len(data) or ((rows < 0) | (rows >= shape[0])).any():
        raise Refused("a sparse matrix with entries outside it")
    budget.spend(prod(shape) * data.itemsize)
    dense = np.zeros(shape, data.dtype)
    np.add.at(dense, (rows, np.repeat(np.arange(shape[1]), counts)), data)
    return dense
