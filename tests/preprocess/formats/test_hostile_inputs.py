"""Seeded mutations of every kind of file a user may give: nothing runs, only InputError comes out and names the file.

$GGAVATAR_MUTATIONS sets how many there are of each kind (60 if not set).
"""

from __future__ import annotations

import json
import resource
import zipfile

import numpy as np
import pytest

from ggavatar.errors import InputError
from ggavatar.io.images import read_gray, read_rgb, write_jpeg, write_png
from ggavatar.io.json_files import read_json
from ggavatar.io.npz import read_npy, read_npz
from preprocess.formats.registry import importer, importer_names
from preprocess.video.sources import open_source
from tests.support.damaged_files import COUNT, check_value_mutations, refused_mutants
from tests.support.synthetic_clip import moving_record, sheap_record, still_camera, weak_perspective, write_video


@pytest.fixture(autouse=True)
def bounded_memory():
    """One gigabyte more than now, at most."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    yield
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 1 << 20


def test_npz(tmp_path):
    path = tmp_path / "mutant.npz"
    for seed, save in enumerate((np.savez, np.savez_compressed)):
        save(path, a=np.arange(50.0), b=np.array("text"), c=np.zeros((3, 4, 5), np.float32))
        assert refused_mutants(path, path.read_bytes(), lambda: read_npz(path), seed) > COUNT // 10


def test_npy(tmp_path):
    """Headers that fail as numpy's, and as Python's tokens; shapes larger than the file."""
    path = tmp_path / "mutant.npy"
    np.save(path, np.arange(24.0).reshape(4, 6))
    original = path.read_bytes()
    assert refused_mutants(path, original, lambda: read_npy(path, 1 << 20), 6) > COUNT // 10
    large = b"{'descr': '<f8', 'fortran_order': False, 'shape': (99999999999,), }"
    for header in (large, b"{'descr': ('<f8'", b"(" * 60, b"  x\n y"):
        path.write_bytes(original[:10] + header.ljust(117) + b"\n" + original[128:])
        with pytest.raises(InputError, match=r"mutant\.npy"):
            read_npy(path, 1 << 20)
    path.write_bytes(original)
    with pytest.raises(InputError, match="at most 100 bytes"):
        read_npy(path, 100)


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_images(tmp_path, suffix):
    path = tmp_path / f"mutant{suffix}"
    image = np.random.default_rng(0).integers(0, 255, (24, 32, 3), dtype=np.uint8)
    write_png(path, image) if suffix == ".png" else write_jpeg(path, image)
    for read in (read_rgb, read_gray):
        assert refused_mutants(path, path.read_bytes(), lambda read=read: read(path), 3) > 0
        write_png(path, image) if suffix == ".png" else write_jpeg(path, image)


def test_json(tmp_path):
    path = tmp_path / "mutant.json"
    text = json.dumps({"schema": "x", "frames": list(range(30)), "nested": {"a": [1.5, None, "é"]}}).encode()
    assert refused_mutants(path, text, lambda: read_json(path), 4) > COUNT // 4
    for odd in (
        b"[" * 100_000,
        b'{"a": NaN}',
        b'{"a": Infinity}',
        b"null",
        b"\xff\xfe",
        b'{"a": 1e999}',
        b"9" * 10_000,
    ):
        path.write_bytes(odd)
        try:
            read_json(path)
        except InputError as error:
            assert "mutant.json" in str(error)


@pytest.mark.parametrize("container", ["mp4", "mkv", "avi"])
def test_videos(tmp_path, container):
    path = tmp_path / f"mutant.{container}"
    write_video(path, [np.full((48, 64, 3), 10 * number, np.uint8) for number in range(10)])

    def read():
        source = open_source(path)
        for frame in source.frames():
            assert frame.image.size <= 3 << 26

    refused_mutants(path, path.read_bytes(), read, 5)


def at_rest(size):
    """A clip whose head does not move in its own coordinates."""
    record = moving_record(3, size)
    record.joint_rotations[:, :2] = 0
    return record


def write_any(name, target):
    """Write a clip of three frames that the format can hold."""
    still = still_camera(3, (96, 96), 300.0)
    for record in (*map(at_rest, ((96, 96), (512, 512))), weak_perspective(3), still, sheap_record(3)):
        try:
            importer(name).write(target, record)
        except InputError:
            continue
        return
    pytest.fail(f"{name} can hold none of the clips; add one such as its tracker makes")


@pytest.mark.parametrize("name", importer_names())
def test_importers(tmp_path, name):
    """Every text and binary file of every format in turn; values as well as bytes."""
    target = tmp_path / ("tracking.npz" if name == "npz" else name)
    write_any(name, target)
    files = [target] if target.is_file() else sorted(path for path in target.rglob("*") if path.is_file())
    kinds = {path.suffix: path for path in files}
    for seed, path in enumerate(kinds.values()):
        original = path.read_bytes()
        refused_mutants(path, original, lambda: importer(name).read(target), seed)
        if path.suffix == ".json":
            check_value_mutations(path, original, lambda: importer(name).read(target), seed)
        path.write_bytes(original)
    assert len(importer(name).read(target).numbers) == 3


def test_archive_with_millions_of_entries(tmp_path):
    path = tmp_path / "many.npz"
    with zipfile.ZipFile(path, "w") as archive:
        for number in range(5000):
            archive.writestr(f"{number}.npy", b"")
    with pytest.raises(InputError, match="at most 4096 members"):
        read_npz(path)


def test_pixel_bomb_in_a_folder_of_images(tmp_path):
    write_png(tmp_path / "00000.png", np.zeros((4, 4), np.uint8))
    data = bytearray((tmp_path / "00000.png").read_bytes())
    data[16:24] = (60_000).to_bytes(4, "big") * 2
    (tmp_path / "00001.png").write_bytes(data)
    source = open_source(tmp_path)
    with pytest.raises(InputError, match=r"00001\.png"):
        list(source.frames())
