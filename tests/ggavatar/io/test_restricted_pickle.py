"""The restricted unpickler: it reads what pickle and torch.save write, and runs no code from a file."""

from __future__ import annotations

import collections
import copyreg
import io
import os
import pickle
import pickletools
import random
import subprocess
import sys
import zipfile

import numpy as np
import pytest
import scipy.sparse
import torch

from ggavatar.errors import InputError
from ggavatar.io import restricted_unpickler
from ggavatar.io.restricted_pickle import read_pickle
from tests.support.flame_files import chumpy_pickle

PLAIN = {
    "array": np.arange(6, dtype=np.float32).reshape(2, 3),
    "fortran": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
    "scalar": np.float64(2.5),
    "empty": np.zeros((0, 3), np.int64),
    "bool": np.array([True, False]),
    "text": np.array(["ab", "c"]),
    "nested": [1, (2.5, "x", None, b"raw", True)],
    "ordered": collections.OrderedDict(a=1),
}


def assert_equal(found, expected):
    if isinstance(expected, np.ndarray | np.generic):
        np.testing.assert_array_equal(found, expected)
        assert found.dtype == expected.dtype
    elif isinstance(expected, dict):
        assert set(found) == set(expected)
        for key in expected:
            assert_equal(found[key], expected[key])
    else:
        assert found == expected


@pytest.mark.parametrize("protocol", range(5))
def test_reads_what_pickle_writes(tmp_path, protocol):
    path = tmp_path / "plain.pkl"
    path.write_bytes(pickle.dumps(PLAIN, protocol))
    assert_equal(read_pickle(path), PLAIN)


def test_reads_torch_archives_of_arrays(tmp_path):
    path = tmp_path / "00000.frame"
    torch.save(PLAIN, path)
    assert_equal(read_pickle(path), PLAIN)


def old_module(data: bytes) -> bytes:
    return data.replace(b"numpy._core.multiarray", b"numpy.core.multiarray")


def test_reads_numpy_1_names(tmp_path):
    path = tmp_path / "old.pkl"
    path.write_bytes(old_module(pickle.dumps(PLAIN["array"], 2)))
    assert_equal(read_pickle(path), PLAIN["array"])


@pytest.mark.parametrize("protocol", [0, 1, 2])
def test_reads_chumpy_and_sparse_without_them(tmp_path, protocol):
    """Reference: chumpy's Select is a.ravel()[idxs].reshape(shape); scipy's own toarray()."""
    array = np.arange(12.0).reshape(3, 4)
    sparse = scipy.sparse.csc_matrix(np.array([[0, 1.5, 0], [2, 0, 0]]))
    state = {
        "_shape": sparse.shape,
        "data": sparse.data,
        "indices": sparse.indices,
        "indptr": sparse.indptr,
        "maxprint": 50,
    }
    values = {
        "ch": ("ch", {"x": array, "_dirty_vars": [1], "_itr": None}),
        "select": ("select", {"a": array, "idxs": np.array([1, 5]), "preferred_shape": (1, 2)}),
        "sparse": ("csc", state),
    }
    path = tmp_path / "model.pkl"
    path.write_bytes(chumpy_pickle(values, protocol))
    assert "chumpy" not in sys.modules
    found = read_pickle(path)
    assert "chumpy" not in sys.modules
    np.testing.assert_array_equal(found["ch"], array)
    np.testing.assert_array_equal(found["select"], [[1.0, 5.0]])
    np.testing.assert_array_equal(found["sparse"], sparse.toarray())


class Runs:
    """Pickles as a call."""

    def __init__(self, function, *arguments):
        self.call = (function, arguments)

    def __reduce__(self):
        return self.call


def payloads(marker):
    """Ways to run code or to get hold of something that could."""
    yield pickle.dumps(Runs(os.system, f"touch {marker}"))
    yield pickle.dumps(Runs(subprocess.Popen, ["touch", str(marker)]))
    yield pickle.dumps(Runs(eval, f"open({str(marker)!r}, 'w')"))
    yield pickle.dumps(Runs(exec, f"open({str(marker)!r}, 'w')"))
    yield pickle.dumps(Runs(open, str(marker), "w"))
    yield pickle.dumps(Runs(getattr, dict, "clear"))
    yield pickle.dumps(Runs(copyreg.add_extension, "os", "system", 200))
    yield pickle.dumps(Runs(np.load, str(marker)))
    yield pickle.dumps(Runs(np.fromfile, str(marker)))
    yield pickle.dumps(Runs(np.zeros, (10**12,)))
    yield pickle.dumps(Runs(np.ndarray, (10**12,)))
    yield pickle.dumps(Runs(bytearray, 10**12))
    yield pickle.dumps(Runs(bytes, 10**12))
    yield pickle.dumps(torch.zeros(3).numpy().__class__)
    yield pickle.dumps({"flame": Runs(os.system, f"touch {marker}")})
    yield b"cos\nsystem\n(S'touch " + str(marker).encode() + b"'\ntR."
    yield b"(S'touch " + str(marker).encode() + b"'\nios\nsystem\n."
    yield b"c__builtin__\neval\n(S'1+1'\ntR."
    yield b"cchumpy.ch\n__builtins__\n."
    yield b"cchumpy.ch\nos.system\n(S'id'\ntR."
    yield b"\x80\x04\x8c\x06chumpy\x8c\x09os.system\x93."
    yield b"cnumpy.core.multiarray\n_reconstruct\n}S'__defaults__'\nN\x86b."
    yield b"ccopy_reg\n_reconstructor\n}S'__defaults__'\nN\x86b."
    yield b"cnumpy\ndtype\n(N}S'resolve'\nI1\nstb."


def test_nothing_runs(tmp_path):
    marker, path = tmp_path / "ran", tmp_path / "evil.pkl"
    defaults = restricted_unpickler._reconstructor.__defaults__
    attempts = list(payloads(marker))
    for payload in attempts:
        path.write_bytes(payload)
        with pytest.raises(InputError, match=r"evil\.pkl") as caught:
            found = read_pickle(path)
            assert not callable(found), pickletools.genops(payload)
            raise InputError(f"{path}: harmless")
        assert "Traceback" not in str(caught.value)
        with zipfile.ZipFile(tmp_path / "evil.frame", "w") as archive:
            archive.writestr("x/data.pkl", payload)
        with pytest.raises(InputError):
            found = read_pickle(tmp_path / "evil.frame")
            raise InputError("harmless")
    assert len(attempts) > 20 and not marker.exists()
    assert restricted_unpickler._reconstructor.__defaults__ == defaults


def test_message_says_what_was_refused(tmp_path):
    path = tmp_path / "evil.frame"
    path.write_bytes(pickle.dumps(Runs(os.system, "id")))
    with pytest.raises(InputError, match=r"refused, since it holds posix\.system"):
        read_pickle(path)


def test_memory_is_bounded(tmp_path):
    """A memo index of 4e9, a declared length of an exabyte, arrays larger than their bytes, nested dictionaries."""
    path = tmp_path / "bomb.pkl"
    fold = b"}" + b"".join(b"q%c" % n + b"}(K\x01h%cK\x02h%cu" % (n, n) for n in range(60)) + b"."
    for data in (
        b"\x80\x02]r\xff\xff\xff\xff.",
        b"\x80\x04\x8e" + (1 << 60).to_bytes(8, "little") + b"x.",
        b"\x80\x05\x96" + (1 << 40).to_bytes(8, "little") + b"x.",
        b"\x80\x02\x8b\xff\xff\xff\x7f.",
        old_module(pickle.dumps(np.zeros(2), 2)).replace(b"K\x02\x85", b"J\xff\xff\xff\x7f\x85"),
        fold,
        b"(" * 5000 + b"t" * 5000 + b".",
    ):
        path.write_bytes(data)
        try:
            found = read_pickle(path)
        except InputError:
            continue
        assert sys.getsizeof(found) < 1 << 20


def test_structures_that_contain_themselves(tmp_path):
    path = tmp_path / "loop.pkl"
    loop: dict[str, object] = {}
    loop["a"], loop["b"] = loop, loop
    path.write_bytes(pickle.dumps(loop))
    with pytest.raises(InputError, match="contains itself"):
        read_pickle(path)


def test_zip_bomb(tmp_path):
    path = tmp_path / "bomb.frame"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("x/data.pkl", pickle.dumps(np.zeros(1 << 22)))
    assert path.stat().st_size < 100_000
    with pytest.raises(InputError, match="unpacks to"):
        read_pickle(path)


@pytest.mark.parametrize("name", ["../data.pkl", "/data.pkl", "data.pkl", "a/b/data.pkl"])
def test_odd_places_in_archives(tmp_path, name):
    path = tmp_path / "odd.frame"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(name, pickle.dumps({}))
    try:
        assert read_pickle(path) == {}
    except InputError as error:
        assert "data.pkl" in str(error)
    assert not (tmp_path.parent / "data.pkl").exists()


def test_other_objects_are_refused(tmp_path):
    path = tmp_path / "object.pkl"
    path.write_bytes(pickle.dumps(np.array([{}], dtype=object)))
    with pytest.raises(InputError, match="refused"):
        read_pickle(path)


def test_missing_empty_and_folder(tmp_path):
    for path in (tmp_path / "absent.pkl", tmp_path):
        with pytest.raises(InputError):
            read_pickle(path)
    (tmp_path / "empty.pkl").write_bytes(b"")
    with pytest.raises(InputError, match=r"empty\.pkl"):
        read_pickle(tmp_path / "empty.pkl")


def test_seeded_mutations_never_escape(tmp_path):
    """Flipped, cut and repeated bytes: either a value or an InputError that names the file; never anything else."""
    buffer = io.BytesIO()
    torch.save(PLAIN, buffer)
    sources = [pickle.dumps(PLAIN, 2), pickle.dumps(PLAIN, 4), buffer.getvalue(), pickle.dumps(PLAIN, 0)]
    generator, path, refused = random.Random(5), tmp_path / "mutant.pkl", 0
    for _ in range(int(os.environ.get("GGAVATAR_MUTATIONS", "400"))):
        data = bytearray(generator.choice(sources))
        for _ in range(generator.randint(1, 6)):
            data[generator.randrange(len(data))] = generator.randrange(256)
        if generator.random() < 0.2:
            del data[generator.randrange(len(data)) :]
        path.write_bytes(data)
        try:
            read_pickle(path)
        except InputError as error:
            refused += 1
            assert "mutant.pkl" in str(error)
    assert refused > 100
