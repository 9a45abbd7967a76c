"""PLY of 3D Gaussians as writers write it, against the values that were written; plyfile is the second reader.

Also covers `ggavatar/formats/splats/sound_rows.py`, `ggavatar/formats/splats/activations.py` and
`ggavatar/formats/splats/axes.py`.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import plyfile
import pytest

from ggavatar.errors import InputError
from ggavatar.formats.splats.gaussian_ply import read_gaussian_ply
from ggavatar.formats.splats.stored_gaussians import StoredGaussians
from tests.support.splat_files import ply

COUNT = 300
FIELDS = ("means", "sh_dc", "sh_rest", "opacity_logits", "log_scales", "quats")


def columns(degree: int = 3, dtype: str = "f4") -> dict[str, np.ndarray]:
    """Columns of a head-sized cloud, without normals."""
    random = np.random.default_rng(degree)
    found = {axis: random.uniform(-0.1, 0.1, COUNT) for axis in "xyz"}
    found |= {f"f_dc_{index}": random.normal(0, 1, COUNT) for index in range(3)}
    found |= {f"f_rest_{index}": random.normal(0, 0.1, COUNT) for index in range(3 * ((degree + 1) ** 2 - 1))}
    found |= {"opacity": random.normal(0, 3, COUNT)}
    found |= {f"scale_{index}": random.uniform(-7, -3, COUNT) for index in range(3)}
    found |= {f"rot_{index}": random.normal(0, 1, COUNT) for index in range(4)}
    return {name: values.astype(np.float32).astype(dtype) for name, values in found.items()}


def read(folder: Path, content: bytes, **options: str) -> StoredGaussians:
    (folder / "a.ply").write_bytes(content)
    return read_gaussian_ply(folder / "a.ply", **options)


def expected(values: dict[str, np.ndarray], degree: int) -> dict[str, np.ndarray]:
    """The arrays in our layout: harmonics [N, K, 3] from a list with all of red first."""

    def stacked(*names: str) -> np.ndarray:
        return np.stack([values[name] for name in names], axis=1)

    size = min((degree + 1) ** 2, 16) - 1
    stored = (degree + 1) ** 2 - 1
    rest = np.zeros((COUNT, size, 3), np.float32)
    for channel in range(3):
        for index in range(size):
            rest[:, index, channel] = values[f"f_rest_{channel * stored + index}"]
    return {
        "means": stacked("x", "y", "z"),
        "sh_dc": stacked("f_dc_0", "f_dc_1", "f_dc_2"),
        "sh_rest": rest,
        "opacity_logits": values["opacity"],
        "log_scales": stacked("scale_0", "scale_1", "scale_2"),
        "quats": stacked("rot_0", "rot_1", "rot_2", "rot_3"),
    }


def assert_holds(rows: StoredGaussians, values: dict[str, np.ndarray], degree: int) -> None:
    for name, array in expected(values, degree).items():
        found = getattr(rows, name)
        assert found.dtype == np.float32
        np.testing.assert_array_equal(found, array.astype(np.float32), err_msg=name)


@pytest.mark.parametrize("encoding", ["binary_little_endian", "binary_big_endian", "ascii"])
@pytest.mark.parametrize("dtype", ["f4", "f8"])
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_encodings_types_and_degrees(tmp_path: Path, encoding: str, dtype: str, degree: int) -> None:
    values = columns(degree, dtype)
    rows = read(tmp_path, ply({"vertex": values}, encoding))
    assert_holds(rows, values, degree)
    assert rows.degree == degree and rows.notes == ()
    vertex = plyfile.PlyData.read(tmp_path / "a.ply")["vertex"]
    np.testing.assert_array_equal(rows.quats[:, 2], vertex["rot_2"].astype(np.float32))


@pytest.mark.parametrize(
    ("newline", "encoding"),
    [(b"\r\n", "binary_little_endian"), (b"\r", "binary_little_endian"), (b"\r\n", "ascii")],
)
def test_line_ends(tmp_path: Path, newline: bytes, encoding: str) -> None:
    """With CR alone, data whose first byte is 10 must not lose it."""
    values = columns(0)
    values["x"][0] = np.frombuffer(b"\x0a\x00\x00\x3d", "<f4")[0]
    assert_holds(read(tmp_path, ply({"vertex": values}, encoding, newline)), values, 0)


def test_comments_of_any_bytes(tmp_path: Path) -> None:
    values = columns(0)
    odd = [bytes(range(1, 10)) + bytes(range(11, 256)), b"end_header", b"element vertex 3", "größe".encode("cp1252")]
    content = ply({"vertex": values}, comments=odd).replace(
        b"element vertex 300\n", b"obj_info \xff\nelement vertex 300\n"
    )
    assert_holds(read(tmp_path, content), values, 0)
    spaced = ply({"vertex": values}).replace(b"property float x\n", b"property\tfloat  x \n")
    assert_holds(read(tmp_path, spaced), values, 0)
    long = ply({"vertex": values}, comments=[b"x" * 900_000])
    assert_holds(read(tmp_path, long), values, 0)


@pytest.mark.parametrize("encoding", ["binary_little_endian", "binary_big_endian", "ascii"])
def test_other_elements_before_and_after(tmp_path: Path, encoding: str) -> None:
    values = columns(1)
    other = {"a": np.arange(5, dtype="u1"), "b": np.arange(5, dtype="f8")}
    elements = {"camera": other, "vertex": values, "extrinsic": {"m": np.arange(16, dtype="f4")}}
    rows = read(tmp_path, ply(elements, encoding))
    assert_holds(rows, values, 1)
    assert rows.notes == ()
    faces = ply({"vertex": values}, encoding).replace(
        b"end_header\n", b"element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    )
    assert_holds(read(tmp_path, faces + (b"3 0 1 2\n" if encoding == "ascii" else b"\x03" + bytes(12))), values, 1)
    front = faces.replace(b"element vertex 300\n", b"element faces 1\nproperty list uchar int v\nelement vertex 300\n")
    if encoding == "ascii":
        start = front.index(b"end_header\n") + len(b"end_header\n")
        assert_holds(read(tmp_path, front[:start] + b"3 0 1 2\n" + front[start:]), values, 1)
    else:
        with pytest.raises(InputError, match="before those with lists"):
            read(tmp_path, front)


def test_trailing_bytes_are_named(tmp_path: Path) -> None:
    values = columns(0)
    rows = read(tmp_path, ply({"vertex": values}) + b"\0" * 7)
    assert_holds(rows, values, 0)
    assert rows.notes == ("7 bytes behind its last row are ignored",)


def test_harmonics_of_degree_4_are_cut(tmp_path: Path) -> None:
    values = columns(4)
    rows = read(tmp_path, ply({"vertex": values}))
    assert_holds(rows, values, 4)
    assert rows.degree == 3 and "degree 4" in rows.notes[0]


def test_flat_gaussians(tmp_path: Path) -> None:
    values = columns(0)
    del values["scale_2"]
    rows = read(tmp_path, ply({"vertex": values}))
    np.testing.assert_array_equal(rows.log_scales[:, 1], values["scale_1"])
    np.testing.assert_allclose(np.exp(rows.log_scales[:, 2]), 1e-9, rtol=1e-5)
    assert "2DGS" in rows.notes[0]


@pytest.mark.parametrize("encoding", ["binary_little_endian", "ascii"])
def test_few_broken_rows_are_dropped_and_counted(tmp_path: Path, encoding: str) -> None:
    values = columns(1)
    values["y"][5], values["f_rest_8"][9] = np.nan, np.inf
    for index in range(4):
        values[f"rot_{index}"][100] = 0
    rows = read(tmp_path, ply({"vertex": values}, encoding))
    kept = np.delete(np.arange(COUNT), [5, 9, 100])
    for name, array in expected(values, 1).items():
        np.testing.assert_array_equal(getattr(rows, name), array[kept], err_msg=name)
    assert rows.notes == ("dropped 3 of 300 Gaussians: 2 with NaN or infinity, 1 with a rotation of length zero",)
    values["scale_0"][200] = -np.inf
    with pytest.raises(InputError, match=r"99% of the Gaussians, found 4 of 300 broken .*first in row 5"):
        read(tmp_path, ply({"vertex": values}, encoding))


def test_a_row_of_zeros_is_dropped_with_its_triangle(tmp_path: Path) -> None:
    values = columns(0) | {"binding_0": np.arange(COUNT, dtype="f4")}
    for array in values.values():
        array[7] = 0
    rows = read(tmp_path, ply({"vertex": values}))
    assert rows.faces is not None
    np.testing.assert_array_equal(rows.faces, np.delete(np.arange(COUNT), 7))


@pytest.mark.parametrize("spelling", [b"nan", b"-nan", b"NaN", b"-nan(ind)", b"1.#QNAN", b"-1.#IND"])
def test_nan_as_c_libraries_print_it(tmp_path: Path, spelling: bytes) -> None:
    content = ply({"vertex": columns(0)}, "ascii")
    start = content.index(b"end_header\n") + len(b"end_header\n")
    content = content[:start] + spelling + content[content.index(b" ", start) :]
    assert read(tmp_path, content).notes == ("dropped 1 of 300 Gaussians: 1 with NaN or infinity",)


def test_infinite_logits_are_opacities_of_0_and_1(tmp_path: Path) -> None:
    values = columns(0)
    values["opacity"][:2] = -np.inf, np.inf
    rows = read(tmp_path, ply({"vertex": values}))
    assert len(rows) == COUNT and rows.opacity_logits[:2].tolist() == [-80, 80] and rows.notes == ()


def linear(values: dict[str, np.ndarray], unit: float = 1.0) -> dict[str, np.ndarray]:
    """The same cloud in another unit, scales as lengths."""
    changed = {name: unit * array for name, array in values.items() if name in "xyz"}
    changed |= {name: unit * np.exp(array) for name, array in values.items() if name.startswith("scale")}
    return values | {name: array.astype(np.float32) for name, array in changed.items()}


@pytest.mark.parametrize("unit", [1.0, 1000.0, 0.01])
def test_linear_scales_are_recognized_and_named(tmp_path: Path, unit: float) -> None:
    values = columns(0)
    rows = read(tmp_path, ply({"vertex": linear(values, unit)}))
    want = expected(values, 0)["log_scales"] + np.log(unit)
    np.testing.assert_allclose(rows.log_scales, want, atol=1e-5)
    assert any("--scales log" in note for note in rows.notes)
    as_logs = read(tmp_path, ply({"vertex": linear(values)}), scales="log")
    np.testing.assert_array_equal(as_logs.log_scales[:, 0], linear(values)["scale_0"])
    assert as_logs.notes == ()
    told = read(tmp_path, ply({"vertex": linear(values)}), scales="linear")
    np.testing.assert_allclose(told.log_scales, expected(values, 0)["log_scales"], atol=1e-5)


@pytest.mark.parametrize("unit", [1.0, 1000.0])
def test_logarithms_in_any_unit_stay_logarithms(tmp_path: Path, unit: float) -> None:
    """In millimeters the logarithms of this cloud are −0.1 to 3.9, or all positive if the smallest are left out."""
    values = columns(0)
    for name in ("x", "y", "z"):
        values[name] *= unit
    for index in range(3):
        values[f"scale_{index}"] = (values[f"scale_{index}"].clip(-6.5, -4) + np.log(unit)).astype(np.float32)
    rows = read(tmp_path, ply({"vertex": values}))
    assert rows.notes == ()
    np.testing.assert_array_equal(rows.log_scales[:, 1], values["scale_1"])


def test_opacities_that_are_no_logits(tmp_path: Path) -> None:
    values = columns(0)
    sigmoid = 1 / (1 + np.exp(-values["opacity"].astype(np.float64)))
    changed = values | {"opacity": sigmoid.astype(np.float32)}
    rows = read(tmp_path, ply({"vertex": changed}))
    found = 1 / (1 + np.exp(-rows.opacity_logits.astype(np.float64)))
    np.testing.assert_allclose(found, sigmoid, atol=2e-6)
    assert any("--opacities logit" in note for note in rows.notes)
    kept = read(tmp_path, ply({"vertex": changed}), opacities="logit")
    np.testing.assert_array_equal(kept.opacity_logits, changed["opacity"])
    assert kept.notes == ()
    constant = values | {"opacity": np.full(COUNT, 0.1, np.float32)}
    assert read(tmp_path, ply({"vertex": constant})).notes == (), "an initial value, or anything"


def test_what_is_not_gaussians_is_said(tmp_path: Path) -> None:
    points = {name: columns(0)["x"] for name in "xyz"} | {
        name: np.arange(COUNT, dtype=np.int64).astype("u1") for name in ("red", "green", "blue")
    }
    with pytest.raises(InputError, match="point cloud"):
        read(tmp_path, ply({"vertex": points}))
    lam = columns(0) | {name: np.zeros(COUNT, np.float32) for name in ("nx", "ny", "nz")}
    for name in lam:
        if name in "xyz":
            lam[name] = lam[name] / 20
        if name.startswith("f_dc"):
            lam[name] = (np.abs(lam[name]) % 1).astype(np.float32)
    assert any("LAM" in note for note in read(tmp_path, ply({"vertex": lam})).notes)
    mip = ply({"vertex": columns(0)}, comments=[b"SplatRenderMode: mip"])
    assert any("antialiasing" in note for note in read(tmp_path, mip).notes)


def test_files_of_the_field() -> None:
    """Right values: ../cases/README.md; the four files hold one cloud."""
    folder = Path(os.environ.get("GGAVATAR_TEST_DATA", "")) / "cases"
    if not (folder / "splat_crlf.ply").is_file():
        pytest.skip("needs $GGAVATAR_TEST_DATA with cases/splat_*.ply")
    crlf = read_gaussian_ply(folder / "splat_crlf.ply")
    assert len(crlf) == 400 and crlf.degree == 1 and crlf.notes == ()
    broken = read_gaussian_ply(folder / "splat_3_nan_rows.ply")
    assert len(broken) == 397 and broken.notes == ("dropped 3 of 400 Gaussians: 3 with NaN or infinity",)
    lengths = read_gaussian_ply(folder / "splat_linear_scales.ply")
    assert any("not logarithms" in note for note in lengths.notes)
    np.testing.assert_allclose(lengths.log_scales, crlf.log_scales, atol=1e-5)
    np.testing.assert_array_equal(broken.log_scales, crlf.log_scales[3:])
