"""Read pickles (FLAME model files, trackers' `.frame` files) and what `torch.save` writes, running none of their code.

`ggavatar/io/restricted_unpickler.py` unpickles, `ggavatar/io/pickle_stand_ins.py` makes plain values of the result.
"""

from __future__ import annotations

import io
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ggavatar.errors import InputError
from ggavatar.io import torch_archives as archives
from ggavatar.io.pickle_stand_ins import Budget, PlainConverter, Refused
from ggavatar.io.regular_files import read_file, read_start, regular_size
from ggavatar.io.restricted_unpickler import DAMAGE_ERRORS, load_stream, unpickle


def read_pickle(path: Path) -> Any:
    """Read the plain content of a pickle or a `torch.save` file: dicts, lists, numbers, text, arrays.

    Tensors and Parameters become arrays; gradients and the device that they were on are left out.

    Raises:
        InputError: The file is missing, damaged, too large, or names anything that is not on the allow-list.
    """
    try:
        return _load(path)
    except InputError:
        raise
    except Refused as error:
        raise InputError(
            f"{path}: refused, since it holds {error}, which no tracker output or FLAME model needs and which "
            "could run code or fill the memory; download the file from its original source"
        ) from error
    except DAMAGE_ERRORS as error:
        raise InputError(
            f"{path}: not a readable pickle ({type(error).__name__}); copy or create the file again"
        ) from error


def _load(path: Path) -> Any:
    expected = "a pickle or a file of torch.save"
    size = regular_size(path, expected, archives.MAX_FILE_BYTES)
    if read_start(path, 2) != b"PK":
        budget = Budget(size)
        return _plain(load_stream(read_file(path, archives.MAX_FILE_BYTES, expected), budget), budget)
    with archives.open_archive(path, size) as archive:
        budget = Budget(max(size, len(archive.pickle)))
        pool = archives.StoragePool(archive.entries)
        return _plain(unpickle(io.BytesIO(archive.pickle), budget, pool), budget)


def _plain(loaded: Any, budget: Budget) -> Any:
    return PlainConverter(budget, partial(_tensor_array, budget)).convert(loaded)


def _tensor_array(budget: Budget, value: object) -> np.ndarray | None:
    if isinstance(value, archives.Storage):
        raise Refused("a storage without a tensor")
    return value.array(budget) if isinstance(value, archives.TensorStandIn) else None
