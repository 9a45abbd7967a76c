"""Videos that are lists of other files, lie about their sizes, or do not end."""

from __future__ import annotations

import struct
from collections.abc import Iterator

from tests.faults.hostile.bases import FILES
from tests.faults.hostile.fixture import Hostile
from tests.faults.hostile.samples import video

_LISTS = {
    "a playlist": b"#EXTM3U\n#EXT-X-MEDIA-SEQUENCE:0\n#EXTINF:1,\n{}\n#EXT-X-ENDLIST\n",
    "a concatenation": b"ffconcat version 1.0\nfile {}\n",
    "SDP": b"v=0\no=- 0 0 IN IP4 127.0.0.1\nc=IN IP4 127.0.0.1\nm=video 9 RTP/AVP 96\na=x:{}\n",
    "DASH": b'<?xml version="1.0"?><MPD xmlns="urn:mpeg:dash:schema:mpd:2011"><BaseURL>{}</BaseURL></MPD>',
    "a pattern of images": b"{}%05d.png\n",
    "RTSP": b"RTSPtextRTSPtext\nrtsp://127.0.0.1:9/{}\n",
    "an image list": b"P6 1 1 255 {}",
    "subtitles": b"1\n00:00:00,000 --> 00:00:01,000\n{}\n",
    "ASS": b"[Script Info]\nScriptType: v4.00+\n[Fonts]\nfontname: {}\n",
}
_TARGETS = (
    b"victim.txt",
    b"file:///etc/passwd",
    b"/dev/zero",
    b"http://127.0.0.1:9/x",
    b"subfile,,start,0,end,9,,:victim.txt",
)


def _box(kind: bytes, content: bytes, size: int | None = None) -> bytes:
    return struct.pack(">I", len(content) + 8 if size is None else size) + kind + content


def _edited(data: bytes, kind: bytes, skip: int, value: bytes) -> bytes:
    """An mp4 with other bytes in the first box of a kind."""
    place = data.index(kind) + 4 + skip
    return data[:place] + value + data[place + len(value) :]


def _mp4s() -> dict[str, bytes]:
    valid, start = video(".mp4"), _box(b"ftyp", b"isom\0\0\2\0isommp41")
    full = b"\xff\xff\xff\xff"
    return {
        "65,535 × 65,535 px": _edited(valid, b"avc1", 24, b"\xff\xff\xff\xff"),
        "no pixels": _edited(valid, b"avc1", 24, b"\0\0\0\0"),
        "a time scale of 0": _edited(valid, b"mdhd", 12, bytes(4)),
        "a time scale of 2^32": _edited(valid, b"mdhd", 12, full),
        "a duration of 2^32": _edited(valid, b"mdhd", 16, full),
        "4 billion samples": _edited(valid, b"stsz", 8, full),
        "samples of 4 GB": _edited(valid, b"stsz", 4, full),
        "4 billion chunks": _edited(valid, b"stco", 4, full),
        "chunks beyond the file": _edited(valid, b"stco", 8, full),
        "4 billion time steps": _edited(valid, b"stts", 4, full),
        "time steps of 2^32": _edited(valid, b"stts", 8, full + full),
        "4 billion entries of stsc": _edited(valid, b"stsc", 4, full),
        "an edit list of 4 billion": _edited(valid, b"elst", 4, full),
        "an edit of negative speed": _edited(valid, b"elst", 16, full),
        "a matrix of zeros": _edited(valid, b"tkhd", 40, bytes(36)),
        "a matrix at its limits": _edited(valid, b"tkhd", 40, b"\x7f" * 36),
        "an unknown codec": valid.replace(b"avc1", b"zzzz"),
        "text as its codec": valid.replace(b"avc1", b"tx3g"),
        "raw pixels of another size": valid.replace(b"avc1", b"raw "),
        "pictures elsewhere": valid.replace(b"url \0\0\0\1", b"url \0\0\0\0"),
        "an alias elsewhere": valid.replace(b"url \0\0\0\1", b"alis\0\0\0\0"),
        "a box of no size": start + struct.pack(">I4s", 0, b"moov"),
        "a box of 3 bytes": start + struct.pack(">I4s", 3, b"moov") + bytes(100),
        "a box of 2^63": start + struct.pack(">I4sQ", 1, b"moov", (1 << 63) - 1),
        "boxes in each other": start + _nested(20_000),
        "100,000 tracks": start + _box(b"moov", _box(b"trak", b"") * 100_000),
        "only a start": start,
        "half of the file": valid[: len(valid) // 2],
        "no index": valid[: valid.index(b"moov") - 4],
        "pictures of zeros": _zeroed(valid),
        "metadata of 30 MB": start + _box(b"moov", _box(b"udta", _box(b"meta", bytes(30 << 20)))),
        "control characters in its title": valid + _box(b"udta", _box(b"\xa9nam", b"\x1b[2J\n::error::x")),
    }


def _nested(depth: int) -> bytes:
    total = 8 * depth
    return b"".join(
        struct.pack(">I4s", total - 8 * level, b"moov" if level == 0 else b"trak") for level in range(depth)
    )


def _zeroed(data: bytes) -> bytes:
    start = data.index(b"mdat") + 4
    size = struct.unpack(">I", data[start - 8 : start - 4])[0] - 8
    return data[:start] + bytes(size) + data[start + size :]


def _ebml() -> dict[str, bytes]:
    valid = video(".webm")
    head = b"\x1a\x45\xdf\xa3\x84\x42\x82\x81\x77"
    unknown = b"\x01\xff\xff\xff\xff\xff\xff\xff"
    return {
        "elements of unknown size in each other": head + (b"\x18\x53\x80\x67" + unknown) * 5000,
        "an element of 2^56": head + b"\x18\x53\x80\x67\x01\xff\xff\xff\xff\xff\xff\xfe",
        "a codec of 1 MB": head
        + b"\x18\x53\x80\x67"
        + unknown
        + b"\x16\x54\xae\x6b"
        + unknown
        + b"\x86\x10\x10\0\0"
        + bytes(1 << 20),
        "half of a WebM": valid[: len(valid) // 2],
        "a WebM of zeros behind its start": valid[:300] + bytes(100_000),
        "one cluster 10,000 times": valid + valid[-200:] * 10_000,
        "65,535 px of VP9": valid.replace(b"\xb0\x81\x40", b"\xb0\x82\xff\xff"),
    }


def _streams() -> dict[str, bytes]:
    ivf = struct.pack("<4sHH4sHHIIII", b"DKIF", 0, 32, b"VP90", 65535, 65535, 25, 1, 0xFFFFFFFF, 0)
    nal = b"\0\0\0\1\x67\x42\xc0\xff" + b"\0" * 40
    return {
        "an IVF of 65,535 px": ivf + struct.pack("<IQ", 0xFFFFFFFF, 0) + bytes(100),
        "H.264 of nothing but headers": nal * 5000,
        "H.264 of start codes": b"\0\0\1" * 300_000,
        "an AVI of 4 GB": b"RIFF\xff\xff\xff\xffAVI LIST\xff\xff\xff\xffhdrlavih" + b"\xff" * 60,
        "an FLV of scripts": b"FLV\1\5\0\0\0\x09\0\0\0\0" + b"\x12\xff\xff\xff" + bytes(1000),
        "a GIF of 65,535 px": b"GIF89a"
        + struct.pack("<HHBBB", 65535, 65535, 0, 0, 0)
        + b",\0\0\0\0\xff\xff\xff\xff\0\x08\x01\0\0;",
        "an Ogg of empty pages": (b"OggS\0\0" + bytes(20) + b"\0") * 20_000,
        "an MPEG-TS of one packet": (b"G" + bytes(187)) * 20_000,
        "text": b"hello\n" * 1000,
        "zeros": bytes(1 << 20),
        "nothing": b"",
        "a PNG": b"\x89PNG\r\n\x1a\n" + bytes(100),
        "a shell script": b"#!/bin/sh\ntouch canary\n",
        "a Lua script": b"-- lua\nos.execute('touch canary')\n",
        "AviSynth": b'AVISource("victim.txt")\n',
    }


def fixtures() -> list[Hostile]:
    """All of them as a video."""
    return list(_fixtures())


def _fixtures() -> Iterator[Hostile]:
    for number, (title, text) in enumerate(_LISTS.items()):
        for target in _TARGETS:
            data = text.replace(b"{}", target)
            name = ("video.mp4", "video.mkv", "video.avi", "video.webm")[number % 4]
            words = f"{title} of {target.decode()[:20]}"
            yield Hostile(words, FILES, "frames", name, {name: data, "victim.txt": b"x"}, refused=True)
    for title, data in (_mp4s() | _streams()).items():
        yield Hostile(f"{title} as mp4", FILES, "frames", "video.mp4", {"video.mp4": data})
    for title, data in _ebml().items():
        yield Hostile(title, FILES, "frames", "video.webm", {"video.webm": data})
