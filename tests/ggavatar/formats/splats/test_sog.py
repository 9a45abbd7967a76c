"""SOG of versions 1 and 2 from known codes, in closed form. Also covers `ggavatar/formats/splats/sog_files.py`."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest

from ggavatar.errors import InputError
from ggavatar.formats.splats.sog import read_sog
from ggavatar.formats.splats.stored_gaussians import rotate_180_about_x
from tests.support.splat_files import sog, sog_1, sog_2, zipped


def unpack(folder: Path, files: dict[str, bytes]) -> Path:
    folder.mkdir(exist_ok=True)
    for name, content in files.items():
        (folder / name).write_bytes(content)
    return folder


@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("form", ["folder", "meta.json", "zip", "zip with a folder"])
def test_values(tmp_path: Path, version: int, form: str) -> None:
    meta, images = sog_1() if version == 1 else sog_2()
    files = sog(meta, images)
    path = tmp_path / "a"
    if "zip" in form:
        path.write_bytes(zipped(files, "nested/" if "folder" in form else ""))
    else:
        unpack(path, files)
    rows = read_sog(path / "meta.json" if form == "meta.json" else path, "world")
    low, high, scales, quats, colors = (images[f"{name}.webp"].astype(float) for name in "lusqc")
    logs = np.array([-0.1, -0.2, 0]) + np.array([0.2, 0.4, 0.3]) * (low + 256 * high) / 65535
    np.testing.assert_allclose(rows.means, np.sign(logs) * (np.exp(np.abs(logs)) - 1), atol=1e-7)
    np.testing.assert_allclose(rows.log_scales, -7 + 4 * scales / 255, atol=1e-6)
    np.testing.assert_allclose(rows.sh_dc, -2 + 4 * colors[:, :3] / 255, atol=1e-6)
    want = -6 + 12 * colors[:, 3] / 255 if version == 1 else np.log(colors[:, 3] / (255 - colors[:, 3]))
    np.testing.assert_allclose(rows.opacity_logits, want, atol=1e-5)
    for row, (*others, tag) in enumerate(quats.tolist()):
        quat = [(value / 255 - 0.5) * np.sqrt(2) for value in others]
        quat.insert(int(tag) - 252, np.sqrt(1 - sum(value * value for value in quat)))
        np.testing.assert_allclose(rows.quats[row], quat, atol=1e-6)
    for row, label in enumerate(images["t.webp"][:, 0].tolist()):
        entry = images["n.webp"][label // 64, 3 * (label % 64) : 3 * (label % 64) + 3]
        np.testing.assert_allclose(rows.sh_rest[row], entry / 127.5 - 1, atol=1e-6)


@pytest.mark.parametrize("degree", [2, 3])
def test_degrees_and_several_rows_of_pixels(tmp_path: Path, degree: int) -> None:
    meta, images = sog_2(8, degree)
    for name in "lusqct":
        images[f"{name}.webp"] = images[f"{name}.webp"].reshape(2, 4, -1)
    (tmp_path / "a.sog").write_bytes(zipped(sog(meta, images)))
    rows = read_sog(tmp_path / "a.sog", "world")
    assert rows.degree == degree and len(rows) == 8
    size, label = (degree + 1) ** 2 - 1, 7 * 13 % 128
    entry = images["n.webp"][label // 64, size * (label % 64) : size * (label % 64 + 1)]
    np.testing.assert_allclose(rows.sh_rest[7], entry / 127.5 - 1, atol=1e-6)


def test_axes_rotations_and_remarks(tmp_path: Path) -> None:
    meta, images = sog_2()
    images["q.webp"][0, 3] = 251
    meta["model"] = "antialiased"
    (tmp_path / "a.sog").write_bytes(zipped(sog(meta, images)))
    found, raw = (read_sog(tmp_path / "a.sog", axes) for axes in ("auto", "world"))
    np.testing.assert_array_equal(found.means, rotate_180_about_x(raw).means)
    assert raw.quats[0].tolist() == [1, 0, 0, 0] and "antialiasing" in raw.notes[0]
    assert "--axes world" in found.notes[-1]


def changed(**parts: object) -> dict[str, bytes]:
    """A SOG of version 2 with other values in its meta.json; None leaves one out."""
    meta, images = sog_2()
    for name, value in parts.items():
        part, _, key = name.partition("__")
        if value is None:
            del meta[part]
        elif key:
            meta[part] = meta[part] | {key: value}
        else:
            meta[part] = value
    return sog(meta, images)


def huge_image() -> bytes:
    """The header of a lossless WebP of 16383 × 16384 pixels."""
    return b"RIFF" + struct.pack("<I", 100) + b"WEBPVP8L" + struct.pack("<IBI", 88, 0x2F, 0x0FFFFFFE) + bytes(80)


@pytest.mark.parametrize(
    ("files", "words"),
    [
        (changed(means=None), "version 2 with|found no means"),
        (changed(quats=None), "found no quats"),
        (changed(version=3), "version 1 or 2"),
        (changed(count=10**12), "1 to 50000000"),
        (changed(count=40_000_000), "pixels, found"),
        (changed(count=-1), "1 to 50000000"),
        (changed(means__mins=[1, 2]), "3 numbers in means.mins"),
        (changed(means__maxs=[1, 2, "3"]), "3 numbers in means.maxs"),
        (changed(scales__codebook=[0.0] * 255), "256 numbers in scales.codebook"),
        (changed(means__files=["l.webp", "../u.webp"]), "without folders"),
        (changed(means__files=["l.webp"]), "2 names"),
        (changed(means__files=["l.webp", "none.webp"]), "none.webp"),
        (changed(shN__files=["l.webp", "t.webp"]), "192, 512 or 960"),
        (changed(shN__files=["n.webp", "c.webp"]), "indices of 128 rows"),
        (changed() | {"l.webp": b"GIF89a" + bytes(30)}, "WebP or PNG"),
        (changed() | {"l.webp": huge_image()}, "pixels, found 16383×16384"),
        (changed() | {"l.webp": changed()["l.webp"][:60]}, "damaged"),
        (changed() | {"meta.json": b"{"}, "not valid JSON"),
        (changed() | {"meta.json": json.dumps({"lodLevels": 3}).encode()}, "expected the meta.json of a SOG"),
    ],
)
def test_what_is_wrong_is_said(tmp_path: Path, files: dict[str, bytes], words: str) -> None:
    (tmp_path / "a.sog").write_bytes(zipped(files))
    for path in (tmp_path / "a.sog", unpack(tmp_path / "b", files)):
        with pytest.raises(InputError, match=words) as found:
            read_sog(path)
        assert path.name in str(found.value)


def test_other_archives_and_levels(tmp_path: Path) -> None:
    (tmp_path / "a.sog").write_bytes(zipped({"a.txt": b""}))
    with pytest.raises(InputError, match=r"found none in it"):
        read_sog(tmp_path / "a.sog")
    (tmp_path / "lod-meta.json").write_text("{}")
    with pytest.raises(InputError, match="several levels"):
        read_sog(tmp_path / "lod-meta.json")
