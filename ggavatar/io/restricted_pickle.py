"""Read pickles (FLAME model files, metrical-tracker's `.frame`) without running any code that they name.

Every class a pickle may name is replaced by an inert stand-in defined here; numpy, scipy and chumpy are never called
with what a file contains. Opcodes outside a short list are refused, and sizes are checked before arrays are allocated.
No other module unpickles.
"""

from __future__ import annotations

import errno
import io
import pickle
import struct
import zipfile
import zlib
from collections.abc import Callable
from math import prod
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from ggavatar.errors import InputError

MAX_PICKLE_BYTES = 1 << 29
"""Largest pickle that is read (512 MiB); FLAME's is 50 MB."""

_ALLOWED_DTYPE_KINDS = frozenset("biufSU")
_REFUSED_OPCODES = frozenset(
    opcode[0]
    for opcode in (
        *(pickle.PERSID, pickle.BINPERSID, pickle.EXT1, pickle.EXT2, pickle.EXT4, pickle.INST, pickle.OBJ),
        *(pickle.NEWOBJ_EX, pickle.BYTEARRAY8, pickle.NEXT_BUFFER, pickle.READONLY_BUFFER, pickle.LONG4),
    )
)
_DAMAGE_ERRORS = (
    *(pickle.UnpicklingError, EOFError, LookupError, ValueError, TypeError, AttributeError, ArithmeticError),
    *(RecursionError, AssertionError, RuntimeError, struct.error),
)


class _Refused(Exception):
    """A pickle asked for something outside the allow-list."""


class _DtypeStandIn:
    """A dtype as pickled: `numpy.dtype(code, …)` followed by its state, of which only the byte order matters."""

    def __init__(self, code: object = "", *_: object) -> None:
        text = code.decode("latin1") if isinstance(code, bytes) else code
        if not isinstance(text, str) or len(text) > 8:
            raise _Refused(f"number type {text!r:.40}")
        self._code, self._little = text, False

    def __setstate__(self, state: object) -> None:
        order = state[1] if isinstance(state, tuple) and len(state) > 1 else "="
        if order not in ("<", "=", "|"):
            raise _Refused("big-endian numbers")
        self._little = order == "<"

    def resolve(self) -> np.dtype[Any]:
        try:
            found = np.dtype(self._code)
        except TypeError as error:
            raise _Refused(f"number type {self._code!r}") from error
        if found.kind not in _ALLOWED_DTYPE_KINDS or found.hasobject:
            raise _Refused(f"number type {self._code!r}")
        return found.newbyteorder("<") if self._little else found


class _ArrayStandIn:
    """An array as pickled: `_reconstruct(…)` followed by (version, shape, dtype, Fortran order, bytes)."""

    def __init__(self, *_: object) -> None:
        self._value: np.ndarray = np.zeros(0)

    def __setstate__(self, state: object) -> None:
        if not isinstance(state, tuple) or len(state) not in (4, 5):
            raise _Refused("an array without its contents")
        shape, kind, fortran, data = state[-4:]
        raw = data.encode("latin1") if isinstance(data, str) else data
        if (
            not isinstance(kind, _DtypeStandIn)
            or not isinstance(raw, bytes)
            or not isinstance(shape, tuple)
            or len(shape) > 8
        ):
            raise _Refused("an array of Python objects")
        number = kind.resolve()
        if not all(type(size) is int and size >= 0 for size in shape) or prod(shape) * number.itemsize != len(raw):
            raise _Refused(f"an array whose {len(raw)} bytes are not those of shape {shape}")
        self._value = np.frombuffer(raw, number).reshape(shape, order="F" if fortran else "C")

    def value(self) -> np.ndarray:
        """The array, sharing the bytes of the pickle (read-only)."""
        return self._value


class _ObjectStandIn:
    """An object of chumpy or scipy: its attributes, never its behavior."""

    def __init__(self, *_: object) -> None:
        self.state: dict[str, Any] = {}

    def __setstate__(self, state: object) -> None:
        if not isinstance(state, dict):
            raise _Refused("an object without attributes")
        self.state = {str(key): value for key, value in state.items()}


class _SelectStandIn(_ObjectStandIn):
    """`chumpy.reordering.Select`: entries of another array."""


class _SparseStandIn(_ObjectStandIn):
    """`scipy.sparse.csc_matrix`."""


class _ClassStandIn:
    """A class that is only ever an argument (numpy.ndarray, object) and must not be called."""

    def __init__(self, *_: object) -> None:
        raise _Refused("an array or object created directly")


def _reconstruct(*_: object) -> _ArrayStandIn:
    return _ArrayStandIn()


def _scalar(kind: object, data: object = b"") -> np.ndarray:
    array = _ArrayStandIn()
    array.__setstate__((1, (), kind, False, data))
    return array.value()


def _encode(text: object, encoding: object = "latin1") -> bytes:
    if not isinstance(text, str) or encoding not in ("latin1", "latin-1"):
        raise _Refused("text in another encoding than latin1")
    return text.encode("latin1")


def _reconstructor(kind: object, *_: object) -> object:
    if isinstance(kind, type) and issubclass(kind, _ObjectStandIn):
        return kind()
    raise _Refused("an unknown object")


class _EmptyBytes:
    """`bytes()` without arguments, as protocol 2 writes empty bytes."""

    def __new__(cls, *arguments: object) -> bytes:  # type: ignore[misc]
        if arguments:
            raise _Refused("bytes converted from another object")
        return b""


_ALLOWED: dict[tuple[str, str], Callable[..., Any]] = {
    **{(f"numpy.{core}.multiarray", "_reconstruct"): _reconstruct for core in ("core", "_core")},
    **{(f"numpy.{core}.multiarray", "scalar"): _scalar for core in ("core", "_core")},
    ("numpy", "ndarray"): _ClassStandIn,
    ("numpy", "dtype"): _DtypeStandIn,
    ("_codecs", "encode"): _encode,
    ("collections", "OrderedDict"): dict,
    **{(f"scipy.sparse{module}", "csc_matrix"): _SparseStandIn for module in ("", ".csc", "._csc")},
    ("chumpy.reordering", "Select"): _SelectStandIn,
    **{(module, "_reconstructor"): _reconstructor for module in ("copy_reg", "copyreg")},
    **{(module, "object"): _ClassStandIn for module in ("__builtin__", "builtins")},
    **{(module, "bytes"): _EmptyBytes for module in ("__builtin__", "builtins")},
}


class _RestrictedUnpickler(pickle._Unpickler):
    """The pure-Python unpickler with an allow-list (a memo index can make the C one allocate gigabytes)."""

    def __init__(self, data: bytes) -> None:
        super().__init__(io.BytesIO(data), encoding="latin1")
        self._remaining_bytes = MAX_PICKLE_BYTES

    def load_build(self) -> None:
        """Set an object's state: stand-ins only, so that a file cannot alter any function or class of this module."""
        state = self.stack.pop()  # type: ignore[attr-defined]
        target = self.stack[-1]  # type: ignore[attr-defined]
        if not isinstance(target, _DtypeStandIn | _ArrayStandIn | _ObjectStandIn):
            raise _Refused("an object with a state of its own")
        if isinstance(target, _ArrayStandIn) and isinstance(state, tuple) and isinstance(state[-1], bytes | str):
            self._remaining_bytes -= len(state[-1])
            if self._remaining_bytes < 0:
                raise _Refused(f"more than {MAX_PICKLE_BYTES >> 20} MiB of arrays")
        target.__setstate__(state)

    dispatch: ClassVar = {
        **{code: load for code, load in pickle._Unpickler.dispatch.items() if code not in _REFUSED_OPCODES},
        pickle.BUILD[0]: load_build,  # type: ignore[dict-item]
    }

    def find_class(self, module: str, name: str) -> Callable[..., Any]:
        if (module, name) in _ALLOWED:
            return _ALLOWED[module, name]
        if module.split(".")[0] == "chumpy" and "." not in name:
            return _ObjectStandIn
        raise _Refused(f"{module}.{name}")


def read_pickle(path: Path) -> Any:
    """Read the plain content (dicts, lists, numbers, text, arrays) of a pickle, or of a tensorless `torch.save` file.

    Raises:
        InputError: The file is missing, damaged, too large, or names anything that is not on the allow-list.
    """
    try:
        data = _pickle_bytes(path)
        return _PlainConverter().convert(_RestrictedUnpickler(data).load())
    except InputError:
        raise
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such file") from error
    except IsADirectoryError as error:
        raise InputError(f"{path}: expected a file, found a folder") from error
    except _Refused as error:
        raise InputError(
            f"{path}: refused, since it holds {error}, which no tracker output or FLAME model needs and which "
            "could run code; download the file from its original source"
        ) from error
    except (zipfile.BadZipFile, zlib.error, NotImplementedError) as error:
        raise InputError(f"{path}: damaged archive ({error}); copy or create the file again") from error
    except OSError as error:
        if error.errno != errno.EINVAL:  # EINVAL: an entry lies before the file's start
            raise
        raise InputError(f"{path}: damaged archive; copy or create the file again") from error
    except _DAMAGE_ERRORS as error:
        raise InputError(
            f"{path}: not a readable pickle ({type(error).__name__}); copy or create the file again"
        ) from error


def _pickle_bytes(path: Path) -> bytes:
    """The pickle itself: the whole file, or `*/data.pkl` of a zip."""
    size = path.stat().st_size
    if size > MAX_PICKLE_BYTES:
        raise InputError(f"{path}: expected at most {MAX_PICKLE_BYTES >> 20} MiB, found {size >> 20} MiB")
    with path.open("rb") as stream:
        if stream.read(2) != b"PK":
            stream.seek(0)
            return stream.read()
    with zipfile.ZipFile(path) as archive:
        inside = [
            info for info in archive.infolist() if info.filename.count("/") == 1 and info.filename.endswith("/data.pkl")
        ]
        if len(inside) != 1:
            raise InputError(f"{path}: expected one data.pkl as torch.save writes it, found {len(inside)} of them")
        if inside[0].file_size > max(64 * size, 1 << 20) or inside[0].file_size > MAX_PICKLE_BYTES:
            raise InputError(f"{path}: unpacks to {inside[0].file_size >> 20} MiB; the file is damaged or hostile")
        with archive.open(inside[0]) as stream:
            return stream.read(inside[0].file_size)


_PLAIN_TYPES = (str, bytes, int, float, complex, set, frozenset, np.ndarray)


class _PlainConverter:
    """Replaces stand-ins by arrays; shared parts are converted once, so a small file cannot expand into a large one."""

    def __init__(self) -> None:
        self._converted: dict[int, tuple[object, Any]] = {}
        self._in_progress: set[int] = set()
        self._remaining_sparse = 4

    def convert(self, value: Any) -> Any:
        """Convert a value to plain content."""
        if id(value) in self._converted:
            return self._converted[id(value)][1]
        if id(value) in self._in_progress or len(self._in_progress) > 50:
            raise _Refused("a structure that contains itself or is nested more than 50 deep")
        self._in_progress.add(id(value))
        result = self._convert_new(value)
        self._in_progress.discard(id(value))
        self._converted[id(value)] = (value, result)
        return result

    def _convert_new(self, value: Any) -> Any:
        if isinstance(value, _ArrayStandIn):
            return value.value()
        if isinstance(value, _ObjectStandIn):
            return self._array_of(value)
        if isinstance(value, dict):
            if not all(isinstance(key, str | int | bytes) for key in value):
                raise _Refused("a dictionary whose keys are not names")
            return {key: self.convert(item) for key, item in value.items()}
        if isinstance(value, list | tuple):
            return type(value)(self.convert(item) for item in value)
        if value is not None and not isinstance(value, _PLAIN_TYPES):
            raise _Refused(f"{type(value).__name__} where a value is expected")
        return value

    def _array_of(self, value: _ObjectStandIn) -> np.ndarray:
        """The array that an object of chumpy or scipy represents."""
        state = {key: self.convert(item) for key, item in value.state.items() if key in _STATE_KEYS}
        if isinstance(value, _SparseStandIn):
            self._remaining_sparse -= 1
            if self._remaining_sparse < 0:
                raise _Refused("more than four sparse matrices")
            return _sparse_to_dense(state)
        if isinstance(value, _SelectStandIn):
            chosen = np.asarray(state["a"]).ravel()[np.asarray(state["idxs"])]
            shape = state.get("preferred_shape")
            return chosen.reshape(shape) if isinstance(shape, tuple) else chosen
        if not isinstance(state.get("x"), np.ndarray):
            raise _Refused("an object of chumpy other than a plain array")
        return state["x"]


_STATE_KEYS = frozenset({"x", "a", "idxs", "preferred_shape", "shape", "_shape", "data", "indices", "indptr"})


def _sparse_to_dense(state: dict[str, Any]) -> np.ndarray:
    """Convert a compressed-column matrix to an array, checking every index."""
    shape = state.get("_shape", state.get("shape"))
    data, rows, starts = (np.asarray(state[key]) for key in ("data", "indices", "indptr"))
    if not isinstance(shape, tuple) or len(shape) != 2 or not all(type(size) is int and size >= 0 for size in shape):
        raise _Refused("a sparse matrix without a shape")
    if prod(shape) > 1 << 22 or len(starts) != shape[1] + 1 or data.shape != rows.shape or data.ndim != 1:
        raise _Refused(f"a sparse matrix of shape {shape} that does not fit its contents")
    counts = np.diff(starts)
    if (counts < 0).any() or starts[0] != 0 or starts[-1] != len(data) or ((rows < 0) | (rows >= shape[0])).any():
        raise _Refused("a sparse matrix with entries outside it")
    dense = np.zeros(shape, data.dtype)
    np.add.at(dense, (rows, np.repeat(np.arange(shape[1]), counts)), data)
    return dense
