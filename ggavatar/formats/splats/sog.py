"""Reader of SOG (PlayCanvas), versions 1 and 2: every attribute is an image with one pixel for a Gaussian.

Version 2 looks bytes up in tables of 256 values, version 1 (without a version number) has them between two ends.
Positions have 16 bits, on a logarithmic scale; harmonics are rows of a palette. Axes are those of the PLY it was made
from.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from ggavatar.errors import InputError
from ggavatar.formats.splats.axes import Axes, in_our_axes
from ggavatar.formats.splats.ply import MAX_ROWS
from ggavatar.formats.splats.quaternion_packing import quats_from_smallest
from ggavatar.formats.splats.sog_files import SogFiles, open_sog, read_image
from ggavatar.formats.splats.sound_rows import sound_rows
from ggavatar.formats.splats.stored_gaussians import StoredGaussians

PALETTE_COLUMNS = 64
"""Entries of the palette of harmonics in one row of its image."""
MAX_PALETTE = 1 << 16
_ADVICE = "export it again, for example with splat-transform"
_NOT_SOG = "the meta.json of a SOG (means, scales, quats, sh0)"


class _Sog(NamedTuple):
    """An opened SOG whose version and number of Gaussians are known."""

    files: SogFiles
    version: int
    gaussians: int

    def part(self, name: str) -> Mapping[str, Any]:
        """The description of an attribute."""
        found = self.files.meta.get(name)
        if not isinstance(found, dict):
            raise InputError(f"{self.files.path}: expected {_NOT_SOG}, found no {name}; {_ADVICE}")
        return found

    def numbers(self, part: str, key: str, count: int) -> Float[ndarray, " N"]:
        """Numbers of an attribute's description."""
        found = self.part(part).get(key)
        values = found if isinstance(found, list) else [found] * count
        if len(values) != count or not all(_is_number(value) for value in values):
            raise InputError(f"{self.files.path}: expected {count} numbers in {part}.{key}, found others; {_ADVICE}")
        return np.array(values, np.float64)

    def names(self, part: str, count: int) -> list[str]:
        """Names of an attribute's images, in the folder of meta.json."""
        found = self.part(part).get("files")
        if not isinstance(found, list) or len(found) != count or not all(_is_plain_name(name) for name in found):
            raise InputError(
                f"{self.files.path}: expected {count} names without folders in {part}.files, found others; {_ADVICE}"
            )
        return found

    def pixels(self, part: str, images: int = 1) -> list[UInt8[ndarray, "N 4"]]:
        """RGBA bytes of the Gaussians in every image of an attribute."""
        most = max(4 * self.gaussians, 1 << 16)
        read = (read_image(self.files, name, (self.gaussians, most)) for name in self.names(part, images))
        return [image.reshape(-1, 4)[: self.gaussians] for image in read]


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e30


def _is_plain_name(name: object) -> bool:
    return isinstance(name, str) and name not in ("", ".", "..") and not set(name) & set("/\\\0") and len(name) < 200


def read_sog(path: Path, axes: Axes = "auto") -> StoredGaussians:
    """Read Gaussians of a zip archive, a folder or its meta.json; `auto` means the axes of viewers.

    Raises:
        InputError: Not a SOG, another version, damaged, or a file is missing.
    """
    files = open_sog(path)
    sog = _Sog(files, *_version_and_count(files))
    colors, logits = _colors(sog)
    rows = StoredGaussians(
        means=_positions(sog),
        sh_dc=colors,
        sh_rest=_harmonics(sog)
        if isinstance(files.meta.get("shN"), dict)
        else np.zeros((sog.gaussians, 0, 3), np.float32),
        opacity_logits=logits,
        log_scales=_scales(sog),
        quats=_rotations(sog),
        notes=_remarks(files.meta),
    )
    return in_our_axes(sound_rows(files.path, rows), axes, is_for_viewers=True)


def _version_and_count(files: SogFiles) -> tuple[int, int]:
    version = files.meta.get("version", 1)
    means = files.meta.get("means")
    shape = means.get("shape") if isinstance(means, dict) else None
    count = files.meta.get("count") if version == 2 else shape[0] if isinstance(shape, list) and shape else None
    if version not in (1, 2) or not isinstance(count, int) or not 1 <= count <= MAX_ROWS:
        raise InputError(
            f"{files.path}: expected {_NOT_SOG} of version 1 or 2 with 1 to {MAX_ROWS} Gaussians, found version "
            f"{str(version)[:20]} with {str(count)[:20]}; {_ADVICE}"
        )
    return version, count


def _remarks(meta: Mapping[str, Any]) -> tuple[str, ...]:
    antialiased = meta.get("model") == "antialiased" or meta.get("antialias") is True
    return ("it was trained with antialiasing (mip-splatting)",) if antialiased else ()


def _positions(sog: _Sog) -> Float[ndarray, "N 3"]:
    """16-bit steps between two ends, of sign(x)·ln(|x| + 1)."""
    low, high = sog.pixels("means", 2)
    steps = (low[:, :3] + 256.0 * high[:, :3]) / 65535
    ends = sog.numbers("means", "mins", 3), sog.numbers("means", "maxs", 3)
    logs = ends[0] + steps * (ends[1] - ends[0])
    with np.errstate(over="ignore"):
        return (np.sign(logs) * np.expm1(np.abs(logs))).astype(np.float32)


def _looked_up(sog: _Sog, part: str, steps: UInt8[ndarray, "N C"]) -> Float[ndarray, "N C"]:
    """Values of bytes: from the table of version 2, or between the ends of version 1."""
    if sog.version == 2:
        return sog.numbers(part, "codebook", 256)[steps]
    low, high = (sog.numbers(part, key, steps.shape[1]) for key in ("mins", "maxs"))
    return low + steps / 255 * (high - low)


def _scales(sog: _Sog) -> Float[ndarray, "N 3"]:
    return _looked_up(sog, "scales", sog.pixels("scales")[0][:, :3]).astype(np.float32)


def _colors(sog: _Sog) -> tuple[Float[ndarray, "N 3"], Float[ndarray, " N"]]:
    """Constant harmonics, and logits of the opacities, which version 2 stores as opacities."""
    (pixels,) = sog.pixels("sh0")
    if sog.version == 1:
        values = _looked_up(sog, "sh0", pixels).astype(np.float32)
        return np.ascontiguousarray(values[:, :3]), np.ascontiguousarray(values[:, 3])
    opacities = pixels[:, 3] / 255
    with np.errstate(divide="ignore"):
        logits = np.log(opacities) - np.log1p(-opacities)
    return _looked_up(sog, "sh0", pixels[:, :3]).astype(np.float32), logits.astype(np.float32)


def _rotations(sog: _Sog) -> Float[ndarray, "N 4"]:
    """Three components from −√½ to √½, and 252 plus the index of the largest of wxyz; other tags mean no rotation."""
    (pixels,) = sog.pixels("quats")
    others = (pixels[:, :3] / 255 - 0.5) * np.sqrt(2)
    quats = quats_from_smallest(others, pixels[:, 3].clip(252) - 252)
    quats[pixels[:, 3] < 252] = (1, 0, 0, 0)
    return quats


def _harmonics(sog: _Sog) -> Float[ndarray, "N K 3"]:
    """Rows of a palette, whose image has 64 entries in a row and a pixel for each coefficient."""
    centroids, labels = sog.names("shN", 2)
    image = read_image(sog.files, centroids, (1, MAX_PALETTE * 15))
    size = image.shape[1] // PALETTE_COLUMNS
    if size not in (3, 8, 15) or image.shape[1] % PALETTE_COLUMNS:
        raise InputError(
            f"{sog.files.path}: expected {centroids} of 192, 512 or 960 pixels width, found {image.shape[1]}; {_ADVICE}"
        )
    palette = image[..., :3].reshape(-1, size, 3)
    tags = read_image(sog.files, labels, (sog.gaussians, max(4 * sog.gaussians, 1 << 16))).reshape(-1, 4)[
        : sog.gaussians
    ]
    rows = tags[:, 0].astype(np.int64) + 256 * tags[:, 1].astype(np.int64)
    if int(rows.max()) >= len(palette):
        raise InputError(
            f"{sog.files.path}: expected indices of {len(palette)} rows in {labels}, found {int(rows.max())}; {_ADVICE}"
        )
    values = _looked_up(sog, "shN", palette.reshape(-1, 3)).reshape(palette.shape)
    return values.astype(np.float32)[rows]
