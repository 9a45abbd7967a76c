"""The archive of an avatar file: a JSON description and safetensors, each under a digest; no code, no pickles.

The description is sealed (`content_sha256`) and holds size and SHA-256 of every other member, so that no bit of the
content can change unnoticed. Equal content gives equal bytes. Readers of the `.ggavatar` layout need nothing but zip,
JSON and safetensors.
"""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import torch
from safetensors import SafetensorError
from safetensors import torch as safetensors
from torch import Tensor

from ggavatar.errors import InputError
from ggavatar.formats.avatar_suffix import DESCRIPTION, EXPECTED
from ggavatar.io.atomic import write_atomically
from ggavatar.io.json_files import SEAL, digest_of, parse_json, sealed
from ggavatar.io.regular_files import regular_size
from ggavatar.io.zip_files import open_zip, read_zipped

SCHEMA, VERSION = "ggavatar-avatar", 1
TENSORS = ("head", "avatar", "tracking")
"""Groups of tensors: one safetensors file each, beside the description."""
MAX_DESCRIPTION_BYTES = 1 << 24
MAX_UNPACKED_BYTES = 1 << 29
"""Most that the members may unpack to (512 MiB)."""
MAX_EXPANSION, FREE_BYTES = 32, 16 << 20
"""Above so many bytes, members unpack to at most so many times the size of the file."""
_REMEDY = "copy the file again, or export the avatar again with ggavatar-export RUN --format avatar"
_DTYPES = (torch.float32, torch.float64, torch.int64, torch.bool)
_EPOCH = (1980, 1, 1, 0, 0, 0)


class Container(NamedTuple):
    """The content of an avatar file.

    Attributes:
        description: Plain values, without schema, version and digests.
        groups: Tensors by name, for each of `TENSORS`.
    """

    description: dict[str, Any]
    groups: dict[str, dict[str, Tensor]]


def write_container(path: Path, content: Container) -> int:
    """Write the file, which appears complete or not at all, and return its size in bytes.

    Raises:
        InputError: It would be larger than readers accept.
        ValueError: A tensor of another type than readers accept, or a number that JSON does not have.
    """
    packed = {f"{name}.safetensors": _packed(content.groups[name]) for name in TENSORS}
    if sum(map(len, packed.values())) > MAX_UNPACKED_BYTES:
        raise InputError(f"{path}: an avatar file holds at most {MAX_UNPACKED_BYTES >> 20} MiB, found a larger avatar")
    members = {name: {"bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()} for name, data in packed.items()}
    described = sealed({"schema": SCHEMA, "version": VERSION, **content.description, "members": members})
    text = json.dumps(described, indent=1, allow_nan=False).encode()
    parts = {DESCRIPTION: text, **packed}
    archive = _zipped(parts, zipfile.ZIP_DEFLATED)
    if _unpacks_to_too_much(sum(map(len, parts.values())), len(archive)):  # an avatar of little but zeros
        archive = _zipped(parts, zipfile.ZIP_STORED)
    write_atomically(path, lambda stream: stream.write(archive))
    return path.stat().st_size


def _zipped(parts: Mapping[str, bytes], method: int) -> memoryview:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", method) as archive:
        for name, data in parts.items():
            info = zipfile.ZipInfo(name, _EPOCH)
            info.external_attr = 0o644 << 16
            archive.writestr(info, data, method, compresslevel=6)
    return buffer.getbuffer()


def _unpacks_to_too_much(unpacked: int, packed: int) -> bool:
    """Whether an archive is larger inside than its own size makes plausible."""
    return unpacked > max(FREE_BYTES, MAX_EXPANSION * packed)


def _packed(tensors: Mapping[str, Tensor]) -> bytes:
    wrong = {name: value.dtype for name, value in tensors.items() if value.dtype not in _DTYPES}
    if wrong:
        raise ValueError(f"expected tensors of {_DTYPES}, got {wrong}")
    return safetensors.save({name: tensors[name].detach().cpu().contiguous() for name in sorted(tensors)})


def read_container(path: Path) -> Container:
    """Read and check an avatar file.

    Raises:
        InputError: No such file, another kind of file, of another version, too large, or changed in any bit.
    """
    size = regular_size(path, EXPECTED, MAX_UNPACKED_BYTES)
    wanted = [DESCRIPTION, *(f"{name}.safetensors" for name in TENSORS)]
    with open_zip(path, EXPECTED) as archive:
        found = archive.namelist()
        if sorted(found) != sorted(wanted):
            raise InputError(
                f"{path}: expected the members {', '.join(wanted)}, found {', '.join(found)[:200] or 'none'}; {_REMEDY}"
            )
        unpacked = sum(info.file_size for info in archive.infolist())
        if unpacked > MAX_UNPACKED_BYTES:
            raise InputError(f"{path}: unpacks to more than {MAX_UNPACKED_BYTES >> 20} MiB; {_REMEDY}")
        if _unpacks_to_too_much(unpacked, size):
            raise InputError(
                f"{path}: expected at most {MAX_EXPANSION} times its size, found {unpacked >> 20} MiB unpacked from "
                f"{size} bytes; {_REMEDY}"
            )
        description = _description(path, read_zipped(archive, DESCRIPTION, MAX_DESCRIPTION_BYTES))
        members = description.pop("members", None)
        groups = {}
        for name in TENSORS:
            member = f"{name}.safetensors"
            data = read_zipped(archive, member, MAX_UNPACKED_BYTES)
            record = members.get(member) if isinstance(members, dict) else None
            if not isinstance(record, dict) or record.get("sha256") != hashlib.sha256(data).hexdigest():
                raise InputError(f"{path}: {member} changed since it was written; {_REMEDY}")
            groups[name] = _unpacked(path, member, data)
    return Container(description, groups)


def _description(path: Path, text: bytes) -> dict[str, Any]:
    values = parse_json(path, text)
    if values.get("schema") != SCHEMA:
        raise InputError(f"{path}: expected the schema {SCHEMA}, found {values.get('schema')!r:.40}; {_REMEDY}")
    if values.get("version") != VERSION:
        raise InputError(
            f"{path}: version {values.get('version')!r:.40} of avatar files is unknown, this version of GGAvatar reads "
            f"{VERSION}; update GGAvatar, or export the avatar again"
        )
    seal = values.pop(SEAL, None)
    if seal != digest_of(values):
        raise InputError(f"{path}: {DESCRIPTION} changed since it was written; {_REMEDY}")
    del values["schema"], values["version"]
    return values


def _unpacked(path: Path, member: str, data: bytes) -> dict[str, Tensor]:
    try:
        tensors = safetensors.load(data)
    except (SafetensorError, ValueError, KeyError, RuntimeError) as error:
        raise InputError(f"{path}: {member} is no safetensors ({str(error)[:100]}); {_REMEDY}") from error
    for name, value in tensors.items():
        if value.dtype not in _DTYPES:
            raise InputError(f"{path}: {member}: {name[:60]!r} is of type {value.dtype}, which it cannot be; {_REMEDY}")
        if value.is_floating_point() and not bool(torch.isfinite(value).all()) and name != SCORES:
            raise InputError(f"{path}: {member}: {name[:60]!r} holds numbers that are not finite; {_REMEDY}")
    return tensors


SCORES = "scores"
"""The one tensor that may hold NaN: expression scores of frames without a face."""
