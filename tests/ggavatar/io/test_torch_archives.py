"""Files of torch.save are read as torch.load(weights_only=False) reads them, without torch and without running code.

Reference: torch itself, which writes and reads the same files. Also covers `ggavatar/io/pickle_stand_ins.py`.
"""

from __future__ import annotations

import io
import pickle
import random
import resource
import struct
import subprocess
import sys
import time
import zipfile

import numpy as np
import pytest
import torch

from ggavatar.errors import InputError
from ggavatar.io.restricted_pickle import read_pickle
from tests.support.damaged_files import refused_mutants

TENSORS = {
    "float": torch.arange(6, dtype=torch.float32).reshape(2, 3),
    "double": torch.linspace(0, 1, 5, dtype=torch.float64),
    "half": torch.tensor([0.5, -2.0], dtype=torch.float16),
    "long": torch.tensor([[1, -2]]),
    "byte": torch.arange(3, dtype=torch.uint8),
    "bool": torch.tensor([True, False]),
    "scalar": torch.tensor(3.5),
    "empty": torch.zeros(0, 3),
    "transposed": torch.arange(6.0).reshape(2, 3).T,
    "sliced": torch.arange(10.0)[3:9:2],
    "expanded": torch.tensor([[1.0], [2.0]]).expand(2, 4),
    "parameter": torch.nn.Parameter(torch.ones(2, 2)),
    "gradient": torch.ones(2, requires_grad=True),
}


def assert_read(path, expected):
    found = read_pickle(path)
    assert set(found) == set(expected)
    for name, tensor in expected.items():
        np.testing.assert_array_equal(found[name], tensor.detach().numpy())
        assert found[name].dtype == tensor.detach().numpy().dtype and found[name].shape == tuple(tensor.shape)


def saved(path, content, **options):
    torch.save(content, path, **options)
    return path


@pytest.mark.parametrize("zipped", [True, False])
def test_tensors_and_parameters(tmp_path, zipped):
    assert_read(saved(tmp_path / "00000.frame", TENSORS, _use_new_zipfile_serialization=zipped), TENSORS)


@pytest.mark.parametrize("protocol", [2, 4, 5])
def test_tensors_of_plain_pickles(tmp_path, protocol):
    (tmp_path / "result.pkl").write_bytes(pickle.dumps(TENSORS, protocol))
    assert_read(tmp_path / "result.pkl", TENSORS)


@pytest.mark.parametrize("zipped", [True, False])
def test_bfloat16_and_shared_storages(tmp_path, zipped):
    whole = torch.arange(8, dtype=torch.bfloat16)
    path = saved(tmp_path / "x.pt", {"a": whole, "b": whole[2:4]}, _use_new_zipfile_serialization=zipped)
    found = read_pickle(path)
    np.testing.assert_array_equal(found["a"], np.arange(8, dtype=np.float32))
    np.testing.assert_array_equal(found["b"], np.array([2, 3], np.float32))


def test_arrays_of_protocol_5(tmp_path):
    """Python 3.14 pickles arrays with protocol 5 if asked for nothing else."""
    content = {"a": np.arange(6.0).reshape(2, 3), "f": np.asfortranarray(np.arange(6).reshape(2, 3))}
    (tmp_path / "x.pkl").write_bytes(pickle.dumps(content, 5))
    found = read_pickle(tmp_path / "x.pkl")
    for name, array in content.items():
        np.testing.assert_array_equal(found[name], array)


def test_attributes_of_dictionaries_and_tensors_are_left_out(tmp_path):
    linear, tensor = torch.nn.Linear(2, 3), torch.ones(2)
    tensor.note = "an attribute"
    found = read_pickle(saved(tmp_path / "x.pt", {"state": linear.state_dict(), "tensor": tensor}))
    np.testing.assert_array_equal(found["state"]["weight"], linear.weight.detach().numpy())
    np.testing.assert_array_equal(found["tensor"], [1, 1])


def test_works_without_torch(tmp_path):
    path = saved(tmp_path / "x.pt", {"a": torch.ones(3)})
    code = (
        "import sys; from pathlib import Path; from ggavatar.io.restricted_pickle import read_pickle; "
        f"print(read_pickle(Path({str(path)!r}))['a'].sum(), 'torch' in sys.modules)"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.split() == ["3.0", "False"]


@pytest.mark.parametrize(
    "content",
    [
        {"x": torch.eye(3).to_sparse()},
        {"x": torch.complex(torch.ones(1), torch.ones(1))},
        {"x": torch.ones(3).untyped_storage()},
        torch.nn.Linear(2, 2),
    ],
)
def test_other_objects_of_torch_are_refused(tmp_path, content):
    with pytest.raises(InputError, match="refused, since it holds"):
        read_pickle(saved(tmp_path / "x.pt", content))


def edited(path, edit):
    """The same archive with an edited data.pkl."""
    with zipfile.ZipFile(path) as archive:
        parts = {info.filename: archive.read(info) for info in archive.infolist()}
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in parts.items():
            archive.writestr(name, edit(data) if name.endswith("/data.pkl") else data)
    return path


def test_views_outside_the_storage_are_refused(tmp_path):
    """Offset, size and stride of a tensor of five numbers, one after the other beyond its storage."""
    good = b"K\x00K\x05\x85q"
    for bad in (b"K\x01K\x05\x85q", b"K\x00K\x06\x85q", b"J\xff\xff\xff\xffK\x05\x85q", b"K\x00J\xff\xff\xff\xff\x85q"):
        path = edited(
            saved(tmp_path / "x.pt", {"x": torch.arange(5.0)}), lambda data, bad=bad: data.replace(good, bad, 1)
        )
        with pytest.raises(InputError, match=r"x\.pt: (refused|not a readable)"):
            read_pickle(path)


def test_an_expanded_tensor_is_no_bomb(tmp_path):
    """One number with stride 0 and a size of 10⁹: 4 GB to copy, refused before."""
    path = saved(tmp_path / "bomb.pt", {"x": torch.ones(1).expand(10**9)})
    assert path.stat().st_size < 3000
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(InputError, match="expand to more than"):
        read_pickle(path)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 1 << 16


def test_missing_and_short_storages(tmp_path):
    path = saved(tmp_path / "x.pt", {"x": torch.arange(5.0)})
    with zipfile.ZipFile(path) as archive:
        parts = {info.filename: archive.read(info) for info in archive.infolist()}
    for name, kept in (("x/data/0", b"\0" * 8), ("x/data/0", None), ("x/byteorder", b"big")):
        with zipfile.ZipFile(path, "w") as archive:
            for part, data in parts.items():
                if part != name or kept is not None:
                    archive.writestr(part, kept if part == name else data)
        with pytest.raises(InputError, match=r"x\.pt"):
            read_pickle(path)


def test_a_stream_that_ends_early(tmp_path):
    path = saved(tmp_path / "x.pt", {"x": torch.arange(5.0)}, _use_new_zipfile_serialization=False)
    whole = path.read_bytes()
    for cut in (1, 20, 24, 28, 200):
        path.write_bytes(whole[:-cut])
        with pytest.raises(InputError, match=r"x\.pt"):
            read_pickle(path)
    path.write_bytes(whole[:-28] + struct.pack("<q", 1 << 40) + whole[-20:])
    with pytest.raises(InputError, match=r"x\.pt"):
        read_pickle(path)


def memoized(rows):
    """A nested structure in which every row holds the one before twice."""
    return b"".join(b"q%c" % row + b"h%ch%c\x86" % (row, row) for row in range(rows))


HOSTILE = {
    "key whose hash takes 2⁶⁰ steps": b"\x80\x02}N" + memoized(60) + b"K\x01s.",
    "set of it": b"\x80\x04\x8f(N" + memoized(60) + b"\x90.",
    "frozen set of it": b"\x80\x04(N" + memoized(60) + b"\x91.",
    "dictionary of it": b"\x80\x02(N" + memoized(60) + b"K\x01d.",
    "pairs of it": b"\x80\x02ccollections\nOrderedDict\n]N" + memoized(60) + b"K\x01\x86a\x85R.",
    "value that prints forever": b"\x80\x02}X\x08\x00\x00\x00img_sizeN" + memoized(40) + b"s.",
    "number type that prints forever": b"\x80\x02cnumpy\ndtype\nN" + memoized(40) + b"\x85R.",
    "shape that prints forever": (
        b"\x80\x02cnumpy.core.multiarray\n_reconstruct\n)R(K\x01N"
        + memoized(40)
        + b"\x85cnumpy\ndtype\nX\x02\x00\x00\x00f4\x85R\x89X\x01\x00\x00\x00at"
        + b"b."
    ),
    "text encoded a thousand times": (
        b"\x80\x02X"
        + struct.pack("<I", 40_000)
        + b"a" * 40_000
        + b"q\x00]("
        + b"c_codecs\nencode\nh\x00\x85R" * 2000
        + b"e."
    ),
    "dictionary copied a thousand times": (
        b"\x80\x02]("
        + b"".join(b"K%cN\x86" % (number % 256) for number in range(5000))
        + b"eq\x01]("
        + b"ccollections\nOrderedDict\nh\x01\x85R" * 2000
        + b"e."
    ),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_small_files_cannot_hang_or_fill_the_memory(tmp_path, name):
    path = tmp_path / "bomb.frame"
    for zipped in (False, True):
        if zipped:
            with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
                archive.writestr("x/data.pkl", HOSTILE[name])
        else:
            path.write_bytes(HOSTILE[name])
        before, began = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
        with pytest.raises(InputError, match=r"bomb\.frame"):
            read_pickle(path)
        assert time.process_time() - began < 5
        assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200 << 10


def test_nested_streams_are_refused(tmp_path):
    """A tensor whose storage is a pickle whose storage is a pickle: as deep as wanted, each read twice."""
    inner = io.BytesIO()
    torch.save(torch.ones(1).untyped_storage(), inner, _use_new_zipfile_serialization=False)
    data = inner.getvalue()
    magic = pickle.dumps(0x1950A86A20F9469CFC6C, 2) + pickle.dumps(1001, 2) + pickle.dumps({}, 2)
    for _ in range(3):
        text = b"B" + struct.pack("<I", len(data)) + data
        data = magic + b"\x80\x03ctorch.storage\n_load_from_bytes\n" + text + b"\x85R." + pickle.dumps([], 2)
    (tmp_path / "deep.pkl").write_bytes(
        b"\x80\x03ctorch.storage\n_load_from_bytes\nB" + struct.pack("<I", len(data)) + data + b"\x85R."
    )
    with pytest.raises(InputError, match="a tensor within a tensor"):
        read_pickle(tmp_path / "deep.pkl")


@pytest.mark.parametrize("kind", ["zip", "stream", "pickle"])
def test_seeded_mutations(tmp_path, kind):
    path = tmp_path / "mutant.frame"
    content = {name: TENSORS[name] for name in ("float", "long", "parameter", "transposed")}
    if kind == "pickle":
        path.write_bytes(pickle.dumps(content, 2))
    else:
        torch.save(content, path, _use_new_zipfile_serialization=kind == "zip")
    assert refused_mutants(path, path.read_bytes(), lambda: read_pickle(path), random.Random(kind).random()) > 5
