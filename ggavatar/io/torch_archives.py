"""Containers that `torch.save` writes, zip and the older stream, and the tensors in them as arrays, without torch.

Nothing of torch is called: a storage is the bytes of its file entry, a tensor a checked view of them that is copied.
Layouts: torch/serialization.py (`_save`, `_legacy_save`) and torch/_utils.py (`_rebuild_tensor_v2`).
"""

from __future__ import annotations

import struct
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from io import BytesIO
from math import prod
from pathlib import Path

import numpy as np

from ggavatar.errors import InputError
from ggavatar.io.pickle_stand_ins import Budget, Refused, checked_sizes
from ggavatar.io.zip_files import open_zip, read_zipped

MAX_FILE_BYTES = 1 << 28
"""Largest file, and largest content of one, that is read (256 MiB); FLAME's is 50 MB."""

LEGACY_MAGIC = 0x1950A86A20F9469CFC6C
"""First object in a file of `torch.save(…, _use_new_zipfile_serialization=False)` and of torch before 1.6."""

_MAX_EXPANSION = 64
_BFLOAT16 = "bfloat16"
STORAGE_TYPES: Mapping[str, str] = {
    **{"FloatStorage": "<f4", "DoubleStorage": "<f8", "HalfStorage": "<f2", "BFloat16Storage": _BFLOAT16},
    **{"LongStorage": "<i8", "IntStorage": "<i4", "ShortStorage": "<i2", "CharStorage": "<i1"},
    **{"ByteStorage": "<u1", "BoolStorage": "?", "UntypedStorage": "<u1"},
}
"""Little-endian numpy type of every storage class of plain numbers."""

SCALAR_TYPES: Mapping[str, str] = {
    **{"float32": "<f4", "float": "<f4", "float64": "<f8", "double": "<f8", "float16": "<f2", "half": "<f2"},
    **{"bfloat16": _BFLOAT16, "int64": "<i8", "long": "<i8", "int32": "<i4", "int": "<i4", "int16": "<i2"},
    **{"short": "<i2", "int8": "<i1", "uint8": "<u1", "bool": "?"},
}
"""The same for `torch.float32` and the like."""


@dataclass(frozen=True)
class TorchType:
    """A storage class or a dtype of torch, as named in a pickle: an argument, never called."""

    code: str

    def __call__(self, *_: object) -> object:
        """Always `Refused`."""
        raise Refused("a storage or tensor created directly")

    @property
    def item_bytes(self) -> int:
        """Bytes of one number."""
        return 2 if self.code == _BFLOAT16 else np.dtype(self.code).itemsize


@dataclass
class Storage:
    """The numbers behind one or several tensors; a stream's are filled in after its objects were read.

    Attributes:
        kind: Type of the numbers.
        count: How many there are.
        read: Returns their bytes.
    """

    kind: TorchType
    count: int
    read: Callable[[], bytes]
    _data: bytes | None = field(default=None, repr=False)

    def data(self) -> bytes:
        """The bytes, read once; `Refused` if there are fewer than `count` numbers."""
        if self._data is None:
            self._data = self.read()
        if len(self._data) < self.count * self.kind.item_bytes:
            raise Refused(f"a tensor of {self.count} numbers with {len(self._data)} bytes")
        return self._data


class TensorStandIn:
    """A tensor or Parameter as pickled: storage, offset, size and stride."""

    def __init__(self, storage: object, offset: object, size: object, stride: object, kind: object = None) -> None:
        if not isinstance(storage, Storage) or not isinstance(kind, TorchType | None):
            raise Refused("a tensor without a storage")
        self._storage, self._kind = storage, kind or storage.kind
        self._size, self._stride = checked_sizes(size), checked_sizes(stride)
        if len(self._size) != len(self._stride) or type(offset) is not int or not 0 <= offset < 1 << 40:
            raise Refused("a tensor whose size and stride do not fit together")
        self._offset = offset

    def __setstate__(self, state: object) -> None:
        """Attributes that somebody set on a Parameter are left out."""

    def array(self, budget: Budget) -> np.ndarray:
        """A contiguous array of its own; `Refused` if the view leaves the storage."""
        item, raw = self._kind.item_bytes, self._storage.data()
        reach = self._offset + sum((size - 1) * step for size, step in zip(self._size, self._stride, strict=True)) + 1
        budget.spend(prod(self._size) * item * (4 if self._kind.code == _BFLOAT16 else 1))
        if 0 in self._size:
            return np.zeros(self._size, "<f4" if self._kind.code == _BFLOAT16 else self._kind.code)
        if reach * item > len(raw):
            raise Refused("a tensor that reaches beyond its storage")
        code = "<u2" if self._kind.code == _BFLOAT16 else self._kind.code
        flat = np.frombuffer(raw, code, len(raw) // item)
        steps = tuple(step * item for step in self._stride)
        view = np.lib.stride_tricks.as_strided(flat[self._offset :], self._size, steps, writeable=False).copy()
        return (view.astype("<u4") << 16).view("<f4") if self._kind.code == _BFLOAT16 else view


def rebuild_tensor(storage: object = None, offset: object = 0, size: object = (), *rest: object) -> TensorStandIn:
    """`torch._utils._rebuild_tensor` and `_rebuild_tensor_v2`; gradients, hooks and metadata are left out."""
    if not rest:
        raise Refused("a tensor without its stride")
    return TensorStandIn(storage, offset, size, rest[0])


def rebuild_tensor_v3(storage: object = None, offset: object = 0, size: object = (), *rest: object) -> TensorStandIn:
    """`torch._utils._rebuild_tensor_v3`, which names the type of the numbers."""
    if len(rest) < 4:
        raise Refused("a tensor without its type")
    return TensorStandIn(storage, offset, size, rest[0], rest[3])


def rebuild_parameter(data: object = None, *_: object) -> TensorStandIn:
    """`torch._utils._rebuild_parameter` and its variant with attributes, which are left out."""
    if not isinstance(data, TensorStandIn):
        raise Refused("a parameter without a tensor")
    return data


def rebuild_from_type(function: object = None, kind: object = None, arguments: object = (), *_: object) -> object:
    """`torch._tensor._rebuild_from_type_v2`: a tensor of a subclass or with attributes, as a plain tensor."""
    for known in (rebuild_tensor, rebuild_tensor_v3, rebuild_parameter):
        if function is known and isinstance(arguments, tuple):
            return known(*arguments)
    raise Refused("a tensor of an unknown kind")


@dataclass(frozen=True)
class Archive:
    """A pickle with the entries that its tensors refer to, all of them within the size limits.

    Attributes:
        pickle: The pickle.
        entries: Functions that read the storages, by key.
    """

    pickle: bytes
    entries: Mapping[str, Callable[[], bytes]] = field(default_factory=dict)


@contextmanager
def open_archive(path: Path, size: int) -> Iterator[Archive]:
    """The pickle and the storages of a zip that `torch.save` wrote; these can be read while it is open.

    Args:
        path: The file.
        size: Its size, bytes.

    Raises:
        InputError: It has no or several `*/data.pkl`, unpacks to far more than its size, is damaged or big-endian.
    """
    with open_zip(path, "a file of torch.save") as archive:
        infos = archive.infolist()
        inside = [info for info in infos if info.filename.count("/") == 1 and info.filename.endswith("/data.pkl")]
        if len(inside) != 1:
            raise InputError(f"{path}: expected one data.pkl as torch.save writes it, found {len(inside)} of them")
        root = inside[0].filename.removesuffix("data.pkl")
        wanted = [info for info in infos if info.filename.startswith(f"{root}data/")]
        claimed = sum(info.file_size for info in (*inside, *wanted))
        if claimed > max(_MAX_EXPANSION * size, 1 << 20) or claimed > MAX_FILE_BYTES:
            raise InputError(f"{path}: unpacks to {claimed >> 20} MiB; the file is damaged or hostile")
        if _byte_order(archive, f"{root}byteorder") == b"big":
            raise InputError(f"{path}: expected little-endian numbers, found a file of a big-endian machine")
        entries = {
            info.filename.removeprefix(f"{root}data/"): partial(read_zipped, archive, info, MAX_FILE_BYTES)
            for info in wanted
        }
        yield Archive(read_zipped(archive, inside[0], MAX_FILE_BYTES), entries)


def _byte_order(archive: zipfile.ZipFile, name: str) -> bytes:
    try:
        return read_zipped(archive, name, 64).strip()
    except KeyError:
        return b"little"


class StoragePool:
    """The storages that the persistent ids of a pickle name; each is made once.

    Args:
        entries: Bytes by key; None for a stream, whose bytes follow its objects.
    """

    def __init__(self, entries: Mapping[str, Callable[[], bytes]] | None) -> None:
        self._entries = entries
        self._storages: dict[str, Storage] = {}

    def load(self, name: object) -> Storage:
        """The storage of a persistent id ("storage", class, key, device, count, …); `Refused` for any other id."""
        if not isinstance(name, tuple) or len(name) not in (5, 6) or name[0] not in ("storage", b"storage"):
            raise Refused("a reference to something outside the file")
        kind, key, count = name[1], name[2], name[4]
        key = key.decode("latin1") if isinstance(key, bytes) else key
        if not isinstance(kind, TorchType) or not isinstance(key, str) or type(count) is not int:
            raise Refused("a tensor of an unknown kind")
        if len(name) == 6 and name[5] is not None:
            raise Refused("a view of a storage, which only torch before 0.4 wrote")
        if not 0 <= count * kind.item_bytes <= MAX_FILE_BYTES:
            raise Refused(f"a tensor of {count} numbers")
        if key not in self._storages:
            self._storages[key] = Storage(kind, count, self._reader(key))
        return self._storages[key]

    def _reader(self, key: str) -> Callable[[], bytes]:
        def missing() -> bytes:
            raise Refused("a tensor whose numbers are not in the file")

        return missing if self._entries is None else self._entries.get(key, missing)

    def fill(self, keys: object, stream: BytesIO) -> None:
        """Read the numbers that follow the objects of a stream, in the order of `keys`.

        Raises:
            Refused: A key is unknown or the file ends early.
        """
        if not isinstance(keys, list):
            raise Refused("a list of tensors that is none")
        for key in _texts(keys):
            storage, head = self._storages.get(key), stream.read(8)
            if storage is None or len(head) != 8:
                raise Refused("numbers of an unknown tensor")
            (count,) = struct.unpack("<q", head)
            if count != storage.count:
                raise Refused(f"a tensor of {storage.count} numbers with {count} in the file")
            data = stream.read(count * storage.kind.item_bytes)
            storage.read = _constant(data)


def _constant(data: bytes) -> Callable[[], bytes]:
    return lambda: data


def _texts(keys: Iterable[object]) -> list[str]:
    texts = [key.decode("latin1") if isinstance(key, bytes) else key for key in keys]
    if not all(isinstance(key, str) for key in texts):
        raise Refused("a list of tensors that is none")
    return [str(key) for key in texts]
