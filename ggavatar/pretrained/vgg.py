"""Weights of VGG16 for perceptual losses: found in the model folders, verified by SHA-256, never downloaded."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from ggavatar.errors import InputError
from ggavatar.io.digests import sha256_of
from ggavatar.pretrained.folders import first_file, model_folders


@dataclass(frozen=True)
class ModelFile:
    """A known file of pretrained weights.

    Attributes:
        name: What it is, for messages.
        file: File name, relative to a searched folder.
        sha256: Digest of the whole file, lower-case hexadecimal.
        license: SPDX identifier.
        source: Where to get it.
    """

    name: str
    file: str
    sha256: str
    license: str
    source: str


VGG16 = ModelFile(
    name="VGG16 trained on ImageNet (torchvision)",
    file="vgg16-397923af.pth",
    sha256="397923af8e79cdbb6a7127f12361acd7a2f83e06b05044ddf496e83de57a5bf0",
    license="BSD-3-Clause",
    source="https://download.pytorch.org/models/vgg16-397923af.pth",
)
VGG16_TO_RELU2_2 = ModelFile(
    name="first four convolutions of VGG16, torchvision's key layout",
    file="vgg16_features_to_relu2_2.pth",
    sha256="39ad811babdd2895d51b672bc95d988b706472d9bc3c0b3a196a686adf8b913b",
    license="BSD-3-Clause",
    source="features.0, 2, 5 and 7 of VGG16; prefer the whole vgg16-397923af.pth",
)


def locate(model: ModelFile, folder: Path | None = None) -> Path | None:
    """The verified file, or None if no searched folder has it.

    Raises:
        InputError: A file of that name has another digest.
    """
    path = first_file(model_folders(folder), [model.file])
    if path is not None:
        _verify(path, model)
    return path


def load_weights(path: Path) -> dict[str, Tensor]:
    """Load the named tensors of a .pth file without executing anything in it.

    Raises:
        InputError: The file holds anything but tensors by name.
    """
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
    except (OSError, MemoryError):
        raise
    except Exception as error:  # damaged files make torch raise many types
        first_line = str(error).partition("\n")[0] or "an empty file"
        raise InputError(f"{path}: expected tensors by name, found other data: {first_line}; get it again") from error
    if not isinstance(state, dict) or not all(isinstance(value, Tensor) for value in state.values()):
        raise InputError(f"{path}: expected tensors by name, found {type(state).__name__}; get it again")
    return dict(state)


def _verify(path: Path, model: ModelFile) -> None:
    digest = sha256_of(path)
    if digest != model.sha256:
        raise InputError(
            f"{path}: expected SHA-256 {model.sha256} ({model.name}), found {digest}; "
            f"get the file again from {model.source}, or remove it"
        )
