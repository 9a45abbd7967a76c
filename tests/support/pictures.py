"""A picture that looks different in each of its eight orientations, and files that store pictures in unusual ways."""

from __future__ import annotations

import struct
import zlib
from fractions import Fraction
from pathlib import Path

import av
import numpy as np


def asymmetric(width: int = 64, height: int = 48) -> np.ndarray:
    """Four corners of different colors on gray; no rotation or reflection maps it onto itself."""
    image = np.full((height, width, 3), 110, np.uint8)
    image[: height // 3, : width // 4] = (220, 40, 40)
    image[: height // 3, -width // 4 :] = (40, 200, 60)
    image[-height // 3 :, : width // 4] = (50, 60, 210)
    image[-height // 3 :, -width // 4 :] = (230, 220, 60)
    return image


def patches(colors: np.ndarray, side: int = 16) -> np.ndarray:
    """Squares of one color each, [rows, columns, channels] → [rows · side, columns · side, channels]."""
    return np.repeat(np.repeat(colors, side, axis=0), side, axis=1)


def patch_values(image: np.ndarray, side: int = 16) -> np.ndarray:
    """The color at the center of each square."""
    return image[side // 2 :: side, side // 2 :: side]


def exif_block(orientation: int, order: str = "<") -> bytes:
    """An EXIF block with an orientation, from its TIFF header on (CIPA DC-008)."""
    start = b"II*\0" if order == "<" else b"MM\0*"
    entries = struct.pack(order + "HHIHH", 0x0100, 3, 1, 7, 0) + struct.pack(
        order + "HHIHH", 0x0112, 3, 1, orientation, 0
    )
    return start + struct.pack(order + "IH", 8, 2) + entries + bytes(4)


def with_png_chunk(data: bytes, kind: bytes, body: bytes, behind_pixels: bool = False) -> bytes:
    """A PNG file with one more chunk, after IHDR or before IEND."""
    chunk = struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
    place = len(data) - 12 if behind_pixels else 33
    return data[:place] + chunk + data[place:]


def with_jpeg_segment(data: bytes, marker: int, body: bytes) -> bytes:
    """A JPEG file with one more segment, first of all."""
    return data[:2] + struct.pack(">BBH", 0xFF, marker, len(body) + 2) + body + data[2:]


def display_p3_profile() -> bytes:
    """An ICC profile of Display P3: its colorants relative to D50, as Apple's profile has them, and sRGB's curve."""
    columns = {"r": (0.51512, 0.24120, -0.00105), "g": (0.29198, 0.69225, 0.04189), "b": (0.15710, 0.06657, 0.78407)}

    def fixed(*values: float) -> bytes:
        return struct.pack(f">{len(values)}i", *(round(value * 65536) for value in values))

    curve = b"para" + bytes(4) + struct.pack(">HH", 3, 0) + fixed(2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)
    text = b"Display P3 of a test\0"
    tags = {
        b"desc": b"desc" + bytes(4) + struct.pack(">I", len(text)) + text + bytes(78),
        b"cprt": b"text" + bytes(4) + b"none\0",
        b"wtpt": b"XYZ " + bytes(4) + fixed(0.9642, 1.0, 0.8249),
        **{f"{name}XYZ".encode(): b"XYZ " + bytes(4) + fixed(*xyz) for name, xyz in columns.items()},
        **{f"{name}TRC".encode(): curve for name in "rgb"},
    }
    table, content, place = b"", b"", 128 + 4 + 12 * len(tags)
    for name, body in tags.items():
        padded = body + bytes(-len(body) % 4)
        table += name + struct.pack(">II", place + len(content), len(body))
        content += padded
    body = struct.pack(">I", len(tags)) + table + content
    header = struct.pack(">I4sI4s4s4s", 128 + len(body), bytes(4), 0x02400000, b"mntr", b"RGB ", b"XYZ ")
    header += bytes(12) + b"acsp" + bytes(28) + fixed(0.9642, 1.0, 0.8249)
    return header.ljust(128, b"\0") + body


def write_frames(
    path: Path, frames: list[av.VideoFrame], codec: str, options: dict[str, str] | None = None, **tags: object
) -> None:
    """A video of frames as they are; tags are attributes of the codec context, such as `color_trc`."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=25, options=options or {})
        stream.width, stream.height, stream.pix_fmt = frames[0].width, frames[0].height, frames[0].format.name
        for name, value in tags.items():
            setattr(stream.codec_context, name, value)
        for number, frame in enumerate(frames):
            frame.pts, frame.time_base = number, Fraction(1, 25)
            for name, value in tags.items():
                if hasattr(frame, name):
                    setattr(frame, name, value)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())


def planar_frame(planes: list[np.ndarray], pixels: str) -> av.VideoFrame:
    """A frame from its planes of 8 or 16 bits."""
    frame = av.VideoFrame(planes[0].shape[1], planes[0].shape[0], pixels)
    for plane, values in zip(frame.planes, planes, strict=True):
        rows = np.zeros((plane.height, plane.line_size // values.itemsize), values.dtype)
        rows[:, : values.shape[1]] = values
        plane.update(rows.tobytes())
    return frame


def yuv_planes(rgb: np.ndarray, red: float, blue: float, bits: int, full: bool) -> list[np.ndarray]:
    """R'G'B' in [0, 1] as Y'CbCr 4:4:4; BT.601, BT.709 and BT.2020 differ in the weights of red and blue."""
    y = rgb @ [red, 1 - red - blue, blue]
    chroma = ((rgb[..., 2] - y) / (2 * (1 - blue)), (rgb[..., 0] - y) / (2 * (1 - red)))
    scale, top = 2 ** (bits - 8), 2**bits - 1
    luma = y * top if full else (16 + 219 * y) * scale
    centered = [c * top + 2 ** (bits - 1) if full else (128 + 224 * c) * scale for c in chroma]
    dtype = np.uint8 if bits == 8 else np.uint16
    return [np.round(values).astype(dtype) for values in (luma, *centered)]


def with_display_matrix(source: Path, target: Path, matrix: tuple[float, float, float, float]) -> None:
    """Copy an mp4 and write a, b, c, d into its track header's matrix (ISO/IEC 14496-12, section 8.3.2)."""
    data = bytearray(source.read_bytes())
    place = data.index(b"tkhd") + 4 + 40
    for index, value in zip((0, 1, 3, 4), matrix, strict=True):
        data[place + 4 * index : place + 4 * index + 4] = round(value * 65536).to_bytes(4, "big", signed=True)
    target.write_bytes(data)
