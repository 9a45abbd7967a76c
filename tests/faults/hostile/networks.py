"""Networks and weights that lie about their tensors, name files elsewhere, or are scripts."""

from __future__ import annotations

import io
import json
import struct
import zipfile
from collections.abc import Iterator

from tests.faults.hostile.bases import FILES, RUN
from tests.faults.hostile.fixture import Hostile
from tests.faults.hostile.samples import BUNDLE, NETWORK
from tests.faults.hostile.samples import FILES as FILES_BY_NAME


def _safetensors(header: object, data: bytes = bytes(64), length: int | None = None) -> bytes:
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    return struct.pack("<Q", len(text) if length is None else length) + text + data


def _entry(kind: str = "F32", shape: object = (4,), offsets: object = (0, 16)) -> dict:
    return {"weight": {"dtype": kind, "shape": shape, "data_offsets": offsets}}


def _weights() -> dict[str, bytes]:
    return {
        "a header of 2^63 bytes": _safetensors({}, length=1 << 63),
        "a header of 2^40 bytes": _safetensors({}, length=1 << 40),
        "a header beyond the file": _safetensors({}, length=1000),
        "a header of brackets": _safetensors(b"[" * 100_000),
        "a header of 50 MB": _safetensors(b'{"__metadata__": {"x": "' + b"x" * (50 << 20) + b'"}}'),
        "a header of a million names": _safetensors(
            {f"{n}": {"dtype": "F32", "shape": [0], "data_offsets": [0, 0]} for n in range(200_000)}, b""
        ),
        "a tensor of 2^62 numbers": _safetensors(_entry(shape=[1 << 62])),
        "a tensor of 2^64 numbers": _safetensors(_entry(shape=[1 << 32, 1 << 32])),
        "a tensor of negative size": _safetensors(_entry(shape=[-4])),
        "a tensor of 1,000 dimensions": _safetensors(_entry(shape=[1] * 1000, offsets=(0, 4)), bytes(4)),
        "a tensor beyond the file": _safetensors(_entry(offsets=(0, 1 << 40))),
        "a tensor that ends before it begins": _safetensors(_entry(offsets=(16, 0))),
        "an unknown type": _safetensors(_entry("Q7")),
        "numbers of 4 bits": _safetensors(_entry("F4", [32])),
        "NaN": _safetensors(_entry(), b"\xff" * 16),
        "no header": b"",
        "seven bytes": bytes(7),
        "metadata of numbers": _safetensors({"__metadata__": {"x": 1}} | _entry(), bytes(16)),
        "metadata of code": _safetensors({"__metadata__": {"x": "__import__('os').system('touch canary')"}} | _entry()),
        "a name that leads out": _safetensors({"../../victim.txt": _entry()["weight"]}, bytes(16)),
    }


def _field(number: int, content: bytes) -> bytes:
    """A field of a protocol buffer with bytes."""
    size, length = bytearray(), len(content)
    while length > 127:
        size.append(length & 127 | 128)
        length >>= 7
    return bytes([number << 3 | 2, *size, length]) + content


def _onnx(*nodes: bytes, tensors: bytes = b"") -> bytes:
    graph = b"".join(_field(1, node) for node in nodes) + _field(2, b"g") + tensors
    return b"\x08\x07" + _field(7, graph) + _field(8, b"\x10\x0c")


def _node(kind: bytes, inputs: tuple[bytes, ...] = (b"src",), outputs: tuple[bytes, ...] = (b"out",)) -> bytes:
    return (
        b"".join(_field(1, name) for name in inputs) + b"".join(_field(2, name) for name in outputs) + _field(4, kind)
    )


def _outside(location: bytes) -> bytes:
    """A tensor whose numbers lie in another file."""
    pair = _field(13, _field(1, b"location") + _field(2, location))
    return _field(5, b"\x08\x04\x10\x01" + _field(8, b"w") + pair + b"\x70\x01")


def _networks() -> dict[str, bytes]:
    """ONNX files; the number of a field is that of onnx.proto."""
    deep = b"x"
    for _ in range(200):
        deep = _field(5, _field(1, b"then_branch") + _field(6, _field(1, _node(b"If") + deep)))
    huge = _field(5, b"\x08\xff\xff\xff\xff\x7f\x08\xff\xff\xff\xff\x7f\x10\x01" + _field(8, b"w"))
    return {
        "numbers in ../victim.txt": _onnx(_node(b"Add", (b"src", b"w")), tensors=_outside(b"../victim.txt")),
        "numbers in /etc/passwd": _onnx(_node(b"Add", (b"src", b"w")), tensors=_outside(b"/etc/passwd")),
        "numbers in /dev/zero": _onnx(_node(b"Add", (b"src", b"w")), tensors=_outside(b"/dev/zero")),
        "a tensor of 2^70 numbers": _onnx(_node(b"Add", (b"src", b"w")), tensors=huge),
        "a circle": _onnx(_node(b"Add", (b"a", b"b"), (b"b",)), _node(b"Add", (b"b", b"a"), (b"a",))),
        "branches 200 deep": _onnx(_node(b"If") + deep),
        "a loop": _onnx(_node(b"Loop")),
        "an operator of its own": _onnx(_node(b"touch canary") + _field(7, b"com.microsoft")),
        "Python in an operator": _onnx(_node(b"PyOp") + _field(5, _field(1, b"module") + _field(4, b"antigravity"))),
        "10,000 nodes": _onnx(*[_node(b"Relu", (b"%d" % n,), (b"%d" % (n + 1),)) for n in range(10_000)]),
        "no nodes": _onnx(),
        "lengths beyond the file": b"\x08\x07\x3a\xff\xff\xff\xff\x0f",
        "a field that does not end": b"\x08" + b"\xff" * 1000,
        "groups in each other": b"\x3b" * 100_000,
        "text": b"hello\n",
        "zeros": bytes(100_000),
        "nothing": b"",
    }


def _script() -> bytes:
    """TorchScript that overwrites the file of a user."""
    import torch

    class Writer(torch.nn.Module):
        def forward(self, x: torch.Tensor) -> torch.Tensor:
            found = torch.from_file("victim.txt", True, 8, dtype=torch.uint8)
            found.fill_(120)
            return x

    stream = io.BytesIO()
    torch.jit.save(torch.jit.script(Writer()), stream)
    return stream.getvalue()


def _tflites() -> dict[str, bytes]:
    valid = FILES_BY_NAME[NETWORK]()
    return {
        "an offset beyond the file": b"\xff\xff\xff\x7fTFL3" + valid[8:],
        "an offset of 0": b"\0\0\0\0TFL3" + valid[8:],
        "its beginning": valid[:1000],
        "half of it": valid[: len(valid) // 2],
        "zeros behind its start": valid[:64] + bytes(10_000),
        "ones behind its start": valid[:64] + b"\xff" * 10_000,
        "its tables zeroed": valid[: len(valid) - 20_000] + bytes(20_000),
        "its tables overwritten": valid[: len(valid) - 20_000] + b"\x7f" * 20_000,
        "text": b"hello",
        "nothing": b"",
    }


def fixtures() -> list[Hostile]:
    """Weights, mask networks, and MediaPipe's networks where they are there."""
    return list(_fixtures())


def _fixtures() -> Iterator[Hostile]:
    for title, data in _weights().items():
        name = "weights.safetensors"
        yield Hostile(f"{title} as weights", FILES, "weights", name, {name: data})
        checkpoint = {"run/checkpoints/step-000000003.safetensors": data}
        yield Hostile(f"{title} as a checkpoint", RUN, "run", "run", checkpoint, True)
    script = _script()
    for suffix in ("torchscript", "pt", "pth", "onnx"):
        yield _mask(f"a script that writes, as .{suffix}", f"mask.{suffix}", script)
    for title, data in _networks().items():
        yield _mask(title, "mask.onnx", data)
        if len(data) < 10_000:
            yield _mask(f"{title} as TorchScript", "mask.torchscript", data)
    if NETWORK in FILES_BY_NAME:
        for title, data in _tflites().items():
            yield Hostile(title, FILES, "landmark-networks", NETWORK, {NETWORK: data}, True)
            inner = zipfile.ZipFile(io.BytesIO(FILES_BY_NAME[BUNDLE]())) if BUNDLE in FILES_BY_NAME else None
            if inner is not None:
                yield Hostile(
                    f"{title} in a bundle", FILES, "landmark-networks", BUNDLE, {BUNDLE: _swapped(inner, data)}, True
                )


def _mask(title: str, name: str, data: bytes) -> Hostile:
    return Hostile(title, FILES, "mask-network", name, {name: data}, True)


def _swapped(bundle: zipfile.ZipFile, data: bytes) -> bytes:
    """The bundle with another landmark network."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for info in bundle.infolist():
            archive.writestr(info.filename, data if "landmarks_detector" in info.filename else bundle.read(info))
    return stream.getvalue()
