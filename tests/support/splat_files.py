"""Files of Gaussians packed from integer codes by the formats' descriptions, so that tests know their exact values."""

from __future__ import annotations

import gzip
import io
import json
import struct
import zipfile
from collections.abc import Mapping, Sequence

import cv2
import numpy as np
import zstandard

PLY_TYPES = {"f4": "float", "f8": "double", "u1": "uchar", "u4": "uint", "i4": "int"}
BYTE_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}


def ply(
    elements: Mapping[str, Mapping[str, np.ndarray]],
    encoding: str = "binary_little_endian",
    newline: bytes = b"\n",
    comments: Sequence[bytes] = (),
) -> bytes:
    """A PLY file; the types of the columns are those of the arrays."""
    lines = [b"ply", f"format {encoding} 1.0".encode(), *(b"comment " + comment for comment in comments)]
    body = b""
    for name, columns in elements.items():
        table = list(columns.values())
        lines.append(f"element {name} {len(table[0])}".encode())
        lines += [f"property {PLY_TYPES[values.dtype.str[1:]]} {column}".encode() for column, values in columns.items()]
        for row in zip(*table, strict=True):
            if encoding == "ascii":
                body += " ".join(repr(value.item()) for value in row).encode() + newline
            else:
                order = BYTE_ORDERS[encoding]
                body += b"".join(np.array([value], value.dtype.newbyteorder(order)).tobytes() for value in row)
    return newline.join([*lines, b"end_header", b""]) + body


def spz_block(version: int, codes: Mapping[str, Sequence[Sequence[int]]]) -> dict[str, bytes]:
    """The blocks of an .spz: `positions` as 24-bit integers (halves in version 1), rotations as bytes or words."""
    positions = np.array(codes["positions"])
    if version == 1:
        packed = positions.astype("<f2").tobytes()
    else:
        packed = b"".join(int(value).to_bytes(3, "little", signed=True) for value in positions.ravel())
    rotations = np.array(codes["rotations"])
    blocks = {"positions": packed}
    blocks |= {name: np.array(codes[name], np.uint8).tobytes() for name in ("alphas", "colors", "scales")}
    blocks["rotations"] = rotations.astype(np.uint8 if version < 3 else "<u4").tobytes()
    return blocks | {"harmonics": np.array(codes.get("harmonics", ()), np.uint8).tobytes()}


def spz(
    version: int, codes: Mapping[str, Sequence], degree: int = 0, fraction_bits: int = 12, axes: int | None = None
) -> bytes:
    """An .spz file of version 1 to 4; `axes` is the number in Adobe's extension."""
    blocks = spz_block(version, codes)
    count, flags = len(codes["alphas"]), 0 if axes is None else 2
    extension = (
        b"" if axes is None else struct.pack("<III", 0xADBE0002, 4, 0) + struct.pack("<III", 0xADBE0003, 4, axes)
    )
    head = struct.pack("<4sIIBBB", b"NGSP", version, count, degree, fraction_bits, flags)
    if version < 4:
        return gzip.compress(head + b"\0" + b"".join(blocks.values()) + extension, mtime=0)
    used = [block for block in blocks.values() if block]
    packed = [zstandard.ZstdCompressor().compress(block) for block in used]
    table = b"".join(struct.pack("<QQ", len(a), len(b)) for a, b in zip(packed, used, strict=True))
    head += struct.pack("<BI12x", len(used), 32 + len(extension))
    return head + extension + table + b"".join(packed)


def webp(pixels: np.ndarray) -> bytes:
    """Lossless WebP of RGBA or RGB bytes [H, W, C]; OpenCV loses RGB where alpha is 0."""
    order = [2, 1, 0, 3][: pixels.shape[2]]
    done, data = cv2.imencode(".webp", np.ascontiguousarray(pixels[..., order]), [cv2.IMWRITE_WEBP_QUALITY, 101])
    assert done
    return data.tobytes()


def sog(meta: Mapping[str, object], images: Mapping[str, np.ndarray]) -> dict[str, bytes]:
    """The files of a SOG; images are [N, C] bytes and become one row each, but for those that are [H, W, C]."""
    files = {name: webp(image if image.ndim == 3 else image[None]) for name, image in images.items()}
    return files | {"meta.json": json.dumps(meta).encode()}


def zipped(files: Mapping[str, bytes], folder: str = "") -> bytes:
    """The same in one archive."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, content in files.items():
            archive.writestr(folder + name, content)
    return stream.getvalue()


SPZ_CODES: dict[str, list] = {
    "positions": [[4096, -2048, 1], [0, -8388608, 8388607], [409, 819, -1229]],
    "alphas": [0, 255, 51],
    "colors": [[0, 127, 255], [128, 64, 32], [1, 2, 3]],
    "scales": [[0, 160, 255], [96, 97, 98], [80, 80, 80]],
    # The largest is w (index 3): x, y, z with sign and 9 bits; then the largest is y.
    "rotations": [3 << 30, (3 << 30) | (511 << 20) | (512 + 100), (1 << 30) | (200 << 20) | (712 << 10) | 300],
    "harmonics": [[128, 0, 255, *range(6)], [*range(100, 109)], [*range(200, 209)]],
}
"""Three Gaussians of degree 1 in version 3 and 4."""


def sog_2(count: int = 5, degree: int = 1) -> tuple[dict, dict[str, np.ndarray]]:
    """meta.json and images of a SOG of version 2 with codes at random."""
    random = np.random.default_rng(7)
    size = (degree + 1) ** 2 - 1

    def codes(*shape: int) -> np.ndarray:
        return random.integers(0, 256, shape, dtype=np.uint8)

    quats, sh0 = codes(count, 4), codes(count, 4)
    quats[:, :3] = 90 + quats[:, :3] % 70
    quats[:, 3] = 252 + np.arange(count) % 4
    sh0[:, 3] = sh0[:, 3].clip(1, 254)
    labels = np.zeros((count, 3), np.uint8)
    labels[:, 0] = np.arange(count) * 13 % 128
    images = {"l.webp": codes(count, 3), "u.webp": codes(count, 3), "s.webp": codes(count, 3), "q.webp": quats}
    images |= {"c.webp": sh0, "n.webp": codes(2, 64 * size, 3), "t.webp": labels}
    table = np.linspace(-7, -3, 256).tolist()
    meta = {
        "version": 2,
        "count": count,
        "means": {"mins": [-0.1, -0.2, 0.0], "maxs": [0.1, 0.2, 0.3], "files": ["l.webp", "u.webp"]},
        "scales": {"codebook": table, "files": ["s.webp"]},
        "quats": {"files": ["q.webp"]},
        "sh0": {"codebook": np.linspace(-2, 2, 256).tolist(), "files": ["c.webp"]},
        "shN": {
            "count": 128,
            "bands": degree,
            "codebook": np.linspace(-1, 1, 256).tolist(),
            "files": ["n.webp", "t.webp"],
        },
    }
    return meta, images


def sog_1() -> tuple[dict, dict[str, np.ndarray]]:
    """The same of version 1: ends instead of tables, the opacity a logit."""
    meta, images = sog_2()
    means = meta["means"] | {"shape": [meta["count"], 3], "dtype": "float32"}
    ends = {"mins": [-7.0] * 3, "maxs": [-3.0] * 3}
    sh0 = {"mins": [-2.0, -2.0, -2.0, -6.0], "maxs": [2.0, 2.0, 2.0, 6.0], "files": ["c.webp"]}
    shn = {"mins": -1.0, "maxs": 1.0, "quantization": 8, "files": ["n.webp", "t.webp"]}
    return {
        "means": means,
        "scales": ends | {"files": ["s.webp"]},
        "quats": {"encoding": "quaternion_packed", "files": ["q.webp"]},
        "sh0": sh0,
        "shN": shn,
    }, images


def compressed_ply(count: int = 300, with_colors: bool = True) -> tuple[dict[str, dict[str, np.ndarray]], bytes]:
    """Elements and bytes of a compressed PLY of degree 1 with codes at random, in chunks of 256."""
    random = np.random.default_rng(3)
    names = [f"{end}_{axis}" for end in ("min", "max") for axis in "xyz"]
    names += [f"{end}_scale_{axis}" for end in ("min", "max") for axis in "xyz"]
    names += [f"{end}_{axis}" for end in ("min", "max") for axis in "rgb"] if with_colors else []
    chunks = -(-count // 256)
    low = {"x": -0.2, "y": -0.1, "z": 0.0, "r": 0.1, "g": 0.2, "b": 0.3}
    chunk = {}
    for name in names:
        base = -7.0 if "scale" in name else low[name[-1]]
        chunk[name] = (base + (name.startswith("max")) * 0.5 + 0.01 * np.arange(chunks)).astype(np.float32)
    words = {
        f"packed_{name}": random.integers(0, 1 << 32, count, dtype=np.uint32)
        for name in ("position", "rotation", "scale", "color")
    }
    sh = {f"f_rest_{index}": random.integers(0, 256, count, dtype=np.uint8) for index in range(9)}
    elements = {"chunk": chunk, "vertex": words, "sh": sh}
    return elements, ply(elements)
