"""Opening a head model of any known kind; the content decides, not the name."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float

from ggavatar.errors import InputError
from ggavatar.head.files import load_head
from ggavatar.head.flame import is_flame, load_flame
from ggavatar.head.gnm import is_gnm, load_gnm
from ggavatar.head.ict import ict_folder, load_ict
from ggavatar.head.model import HeadModel

KINDS = (
    "FLAME's generic_model.pkl, flame2023.pkl or flame2023_Open.pkl, a head.npz, GNM's gnm_head.npz, or ICT-FaceKit's "
    "folder FaceXModel"
)
"""What can be opened, for messages."""


def open_head(path: Path, identity: Float[np.ndarray, " S"] | None = None, expressions: int = 100) -> HeadModel:
    """Read a head model and fold an identity into it; a head.npz has its own already.

    Args:
        path: A file, or a folder of ICT-FaceKit.
        identity: Identity coefficients of that model; None is its mean.
        expressions: Number of FLAME's and GNM's expression coefficients to keep.

    Raises:
        InputError: None of the known kinds, or damaged.
    """
    if path.is_dir():
        if ict_folder(path) is None:
            raise InputError(f"{path}: expected {KINDS}; found a folder without ICT-FaceKit's files")
        return load_ict(path, identity)
    if not path.is_file():
        raise InputError(f"{path}: no such head model; expected {KINDS}")
    if is_flame(path):
        return load_flame(path, identity, expressions=expressions)
    return load_gnm(path, identity, expressions) if is_gnm(path) else load_head(path)


def is_head_file(path: Path) -> bool:
    """Whether a head model is (or would be) a head.npz, which any tracking may be meant for, and no published model."""
    return not path.is_dir() and not is_flame(path) and not is_gnm(path)
