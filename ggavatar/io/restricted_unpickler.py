"""An unpickler that runs nothing that a file names, in bounded time and memory.

Every class a pickle may name is replaced by an inert stand-in; numpy, scipy, chumpy and torch are never called with
what a file contains. Opcodes outside a short list are refused, keys that are hashed are names or small numbers, and a
`Budget` counts the opcodes and what they allocate. No other module unpickles.
"""

from __future__ import annotations

import io
import pickle
import struct
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Any, ClassVar

import numpy as np

from ggavatar.io import torch_archives as archives
from ggavatar.io.pickle_stand_ins import (
    ArrayStandIn,
    Budget,
    ClassStandIn,
    DtypeStandIn,
    ObjectStandIn,
    Refused,
    SelectStandIn,
    SparseStandIn,
    array_of,
    check_key,
    checked_sizes,
)

MAX_ARGUMENTS, MAX_NAME = 16, 200
CALL_BYTES, SET_BYTES = 256, 256
"""About what a stand-in and an empty set take; other objects of one opcode take up to 100 bytes."""

_REFUSED_OPCODES = frozenset(
    opcode[0]
    for opcode in (
        *(pickle.PERSID, pickle.EXT1, pickle.EXT2, pickle.EXT4, pickle.INST, pickle.OBJ),
        *(pickle.NEWOBJ_EX, pickle.NEXT_BUFFER, pickle.READONLY_BUFFER, pickle.LONG4),
    )
)
DAMAGE_ERRORS = (
    *(pickle.UnpicklingError, EOFError, LookupError, ValueError, TypeError, AttributeError, ArithmeticError),
    *(RecursionError, AssertionError, RuntimeError, MemoryError, struct.error),
)
"""What Python's unpickler and the stand-ins raise for damaged data."""

_SETS = frozenset({pickle.EMPTY_SET[0], pickle.FROZENSET[0]})
_TEXTS = tuple(code[0] for code in (pickle.UNICODE, pickle.BINUNICODE, pickle.SHORT_BINUNICODE, pickle.BINUNICODE8))


def _encode(budget: Budget, text: object, encoding: object = "latin1") -> bytes:
    if not isinstance(text, str) or encoding not in ("latin1", "latin-1"):
        raise Refused("text in another encoding than latin1")
    budget.spend(len(text))
    return text.encode("latin1")


def _scalar(budget: Budget, kind: object, data: object = b"") -> np.ndarray:
    return array_of(budget, data, kind, (), "C")


def _frombuffer(budget: Budget, data: object, kind: object, shape: object, order: object = "C", *_: object) -> Any:
    return array_of(budget, data, kind, shape, "F" if order == "F" else "C")


def _ordered(budget: Budget, pairs: object = ()) -> dict[Any, Any]:
    """`collections.OrderedDict()`, or with the list of pairs that Python 2 wrote."""
    if not isinstance(pairs, list | tuple):
        raise Refused("a dictionary made of another object")
    budget.spend(100 * len(pairs))
    result = {}
    for pair in pairs:
        if not isinstance(pair, list | tuple) or len(pair) != 2:
            raise Refused("a dictionary made of another object")
        check_key(pair[0])
        result[pair[0]] = pair[1]
    return result


def _size(*sizes: object) -> tuple[object, ...]:
    """`torch.Size`: a tuple."""
    return checked_sizes(sizes[0]) if len(sizes) == 1 else ()


def _reconstructor(kind: object, *_: object) -> object:
    if isinstance(kind, type) and issubclass(kind, ObjectStandIn):
        return kind()
    raise Refused("an unknown object")


class _EmptyBytes:
    """`bytes()` without arguments, as protocol 2 writes empty bytes."""

    def __new__(cls, *arguments: object) -> bytes:  # type: ignore[misc]
        if arguments:
            raise Refused("bytes converted from another object")
        return b""


_ALLOWED: dict[tuple[str, str], Callable[..., Any]] = {
    ("numpy", "ndarray"): ClassStandIn,
    ("numpy", "dtype"): DtypeStandIn,
    **{(f"scipy.sparse{module}", "csc_matrix"): SparseStandIn for module in ("", ".csc", "._csc")},
    ("chumpy.reordering", "Select"): SelectStandIn,
    **{(module, "_reconstructor"): _reconstructor for module in ("copy_reg", "copyreg")},
    **{(module, "object"): ClassStandIn for module in ("__builtin__", "builtins")},
    **{(module, "bytes"): _EmptyBytes for module in ("__builtin__", "builtins")},
    **{("torch", name): archives.TorchType(code) for name, code in archives.STORAGE_TYPES.items()},
    **{("torch", name): archives.TorchType(code) for name, code in archives.SCALAR_TYPES.items()},
    ("torch.storage", "UntypedStorage"): archives.TorchType("<u1"),
    **{("torch._utils", f"_rebuild_tensor{version}"): archives.rebuild_tensor for version in ("", "_v2")},
    ("torch._utils", "_rebuild_tensor_v3"): archives.rebuild_tensor_v3,
    **{("torch._utils", f"_rebuild_parameter{kind}"): archives.rebuild_parameter for kind in ("", "_with_state")},
    ("torch._tensor", "_rebuild_from_type_v2"): archives.rebuild_from_type,
    ("torch", "Size"): _size,
    **{(f"torch{module}", name): ClassStandIn for module, name in ((".nn.parameter", "Parameter"), ("", "Tensor"))},
}


class _Metered(dict[int, Callable[[Any], None]]):
    """The functions of the opcodes, each counted when it is looked up."""

    def __init__(self, budget: Budget, functions: Mapping[int, Callable[[Any], None]]) -> None:
        super().__init__(functions)
        self._budget = budget

    def __getitem__(self, code: int) -> Callable[[Any], None]:
        self._budget.step()
        if code in _SETS:
            self._budget.spend(SET_BYTES)
        return super().__getitem__(code)


def _measured_text(code: int) -> Callable[[Any], None]:
    load = pickle._Unpickler.dispatch[code]
    return lambda unpickler: unpickler.load_text(load)


class _RestrictedUnpickler(pickle._Unpickler):
    """The pure-Python unpickler with an allow-list (a memo index can make the C one allocate gigabytes)."""

    def __init__(
        self, stream: io.BytesIO, budget: Budget, storages: archives.StoragePool | None = None, nested: bool = False
    ) -> None:
        super().__init__(stream, encoding="latin1")
        self.dispatch = _Metered(budget, self.dispatch)  # type: ignore[misc]
        self._budget, self._storages, self._nested = budget, storages, nested
        self._spending: dict[tuple[str, str], Callable[..., Any]] = {
            **{(f"numpy.{core}.multiarray", "_reconstruct"): self._array for core in ("core", "_core")},
            **{(f"numpy.{core}.multiarray", "scalar"): partial(_scalar, budget) for core in ("core", "_core")},
            **{(f"numpy.{core}.numeric", "_frombuffer"): partial(_frombuffer, budget) for core in ("core", "_core")},
            ("_codecs", "encode"): partial(_encode, budget),
            ("collections", "OrderedDict"): partial(_ordered, budget),
            ("torch.storage", "_load_from_bytes"): self._storage_of_bytes,
        }

    def _array(self, *_: object) -> ArrayStandIn:
        return ArrayStandIn(self._budget)

    def _storage_of_bytes(self, data: object = None) -> archives.Storage:
        """A storage in a pickle of its own, as `pickle.dump` writes a tensor; not within another such pickle."""
        if not isinstance(data, bytes) or self._nested:
            raise Refused("a tensor within a tensor")
        self._budget.spend(len(data))
        found = load_stream(data, self._budget, nested=True)
        if not isinstance(found, archives.Storage):
            raise Refused("a storage that is none")
        return found

    def persistent_load(self, pid: Any) -> archives.Storage:
        if self._storages is None:
            raise Refused("a reference to something outside the file")
        self._budget.spend(CALL_BYTES)
        return self._storages.load(pid)

    def load_build(self) -> None:
        """Set an object's state: stand-ins only, so that a file cannot alter any function or class of this module."""
        state = self.stack.pop()  # type: ignore[attr-defined]
        target = self.stack[-1]  # type: ignore[attr-defined]
        if isinstance(target, dict):
            return  # attributes of an OrderedDict, such as the _metadata of torch's state_dict
        if not isinstance(target, DtypeStandIn | ArrayStandIn | ObjectStandIn | archives.TensorStandIn):
            raise Refused("an object with a state of its own")
        target.__setstate__(state)

    def load_reduce(self) -> None:
        """Call one of the functions below with a tuple of a few arguments; anything else would be iterated over."""
        arguments = self._arguments()
        target = self.stack[-1]  # type: ignore[attr-defined]
        if isinstance(target, archives.TorchType) or not callable(target):
            raise Refused("a call of something that is no function")
        self.stack[-1] = target(*arguments)  # type: ignore[attr-defined]

    def load_newobj(self) -> None:
        """The same for `class.__new__`, of which only stand-ins are here."""
        arguments = self._arguments()
        target = self.stack[-1]  # type: ignore[attr-defined]
        if not isinstance(target, type) or not issubclass(target, ObjectStandIn | DtypeStandIn | _EmptyBytes):
            raise Refused("an object of an unknown class")
        self.stack[-1] = target(*arguments)  # type: ignore[attr-defined]

    def _arguments(self) -> tuple[object, ...]:
        arguments = self.stack.pop()  # type: ignore[attr-defined]
        if type(arguments) is not tuple or len(arguments) > MAX_ARGUMENTS:
            raise Refused("a call with other arguments than a short tuple")
        self._budget.spend(CALL_BYTES)
        return arguments

    def load_text(self, load: Callable[[Any], None]) -> None:
        """Text, of which one character outside of Latin-1 makes all others four times as large."""
        load(self)
        text = self.stack[-1]  # type: ignore[attr-defined]
        if not text.isascii():
            self._budget.spend(4 * len(text))

    def load_bytearray8(self) -> None:
        """A bytearray of protocol 5, whose length is checked against what is left of the file."""
        (size,) = struct.unpack("<Q", self.read(8))  # type: ignore[attr-defined]
        self._budget.spend(size)
        self.append(self.read(size))  # type: ignore[attr-defined]

    def load_setitem(self) -> None:
        check_key(self.stack[-2])  # type: ignore[attr-defined]
        super().load_setitem()  # type: ignore[misc]

    def load_setitems(self) -> None:
        self._check_keys(self.stack[::2])  # type: ignore[attr-defined]
        super().load_setitems()  # type: ignore[misc]

    def load_dict(self) -> None:
        self._check_keys(self.stack[::2])  # type: ignore[attr-defined]
        super().load_dict()  # type: ignore[misc]

    def load_additems(self) -> None:
        self._check_keys(self.stack)  # type: ignore[attr-defined]
        super().load_additems()  # type: ignore[misc]

    def load_frozenset(self) -> None:
        self._check_keys(self.stack)  # type: ignore[attr-defined]
        super().load_frozenset()  # type: ignore[misc]

    def _check_keys(self, keys: Iterable[object]) -> None:
        for key in keys:
            check_key(key)

    dispatch: ClassVar = {
        **{code: load for code, load in pickle._Unpickler.dispatch.items() if code not in _REFUSED_OPCODES},
        pickle.REDUCE[0]: load_reduce,  # type: ignore[dict-item]
        pickle.NEWOBJ[0]: load_newobj,  # type: ignore[dict-item]
        **{code: _measured_text(code) for code in _TEXTS},
        pickle.BUILD[0]: load_build,  # type: ignore[dict-item]
        pickle.BYTEARRAY8[0]: load_bytearray8,  # type: ignore[dict-item]
        pickle.SETITEM[0]: load_setitem,  # type: ignore[dict-item]
        pickle.SETITEMS[0]: load_setitems,  # type: ignore[dict-item]
        pickle.DICT[0]: load_dict,  # type: ignore[dict-item]
        pickle.ADDITEMS[0]: load_additems,  # type: ignore[dict-item]
        pickle.FROZENSET[0]: load_frozenset,  # type: ignore[dict-item]
    }

    def find_class(self, module: str, name: str) -> Callable[..., Any]:
        if len(module) + len(name) > MAX_NAME:
            raise Refused("a name of a class that is none")
        allowed = self._spending.get((module, name)) or _ALLOWED.get((module, name))
        if allowed is not None:
            return allowed
        if module.split(".")[0] == "chumpy" and "." not in name:
            return ObjectStandIn
        raise Refused(f"{module}.{name}".encode("ascii", "backslashreplace").decode())


def unpickle(stream: io.BytesIO, budget: Budget, storages: archives.StoragePool | None = None) -> Any:
    """The next object of a stream: plain values and stand-ins.

    Args:
        stream: Where to read from; it is left behind the object.
        budget: What the object may take.
        storages: The numbers of its tensors; without, it may refer to nothing outside of itself.

    Raises:
        Refused: It asks for something outside the allow-list, or takes too much.
        Exception: Any of `DAMAGE_ERRORS`.
    """
    return _RestrictedUnpickler(stream, budget, storages).load()


def load_stream(data: bytes, budget: Budget, nested: bool = False) -> Any:
    """A pickle, or the five pickles and the numbers of torch's older container; `nested` within a tensor."""
    stream = io.BytesIO(data)
    pool = archives.StoragePool(None)
    first = _RestrictedUnpickler(stream, budget, nested=nested).load()
    if first != archives.LEGACY_MAGIC or type(first) is not int:
        return first
    unpickle(stream, budget)
    system = unpickle(stream, budget)
    if not isinstance(system, dict) or system.get("little_endian", True) is not True:
        raise Refused("numbers of a big-endian machine")
    loaded = _RestrictedUnpickler(stream, budget, pool, nested).load()
    pool.fill(unpickle(stream, budget), stream)
    return loaded
