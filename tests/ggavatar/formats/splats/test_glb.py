"""glTF binary against the extension's text: decoded here by hand, by gltf-validator and by @gltf-transform/core."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ggavatar.errors import InputError
from ggavatar.formats.splats import glb
from ggavatar.formats.splats.glb import write_glb
from ggavatar.formats.splats.stored_gaussians import StoredGaussians, to_stored
from tests.support.gaussian_cloud import cloud
from tests.support.npm_programs import node

PREFIX = "KHR_gaussian_splatting:"
COUNTS = {0: [1], 1: [1, 3], 2: [1, 3, 5], 3: [1, 3, 5, 7]}


def decoded(path: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """The JSON, and the attributes of the only primitive, by glTF 2.0 (sections 3.6 and 4.4)."""
    data = path.read_bytes()
    magic, version, length = struct.unpack_from("<4sII", data)
    assert (magic, version, length) == (b"glTF", 2, len(data))
    size, kind = struct.unpack_from("<I4s", data, 12)
    assert kind == b"JSON" and size % 4 == 0
    text, rest = data[20 : 20 + size], data[20 + size :]
    binary_size, kind = struct.unpack_from("<I4s", rest)
    assert kind == b"BIN\0" and binary_size == len(rest) - 8 and binary_size % 4 == 0
    document = json.loads(text)
    ((primitive,),) = (mesh["primitives"] for mesh in document["meshes"])
    found = {}
    for name, index in primitive["attributes"].items():
        accessor = document["accessors"][index]
        view = document["bufferViews"][accessor["bufferView"]]
        width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor["type"]]
        dtype = {5126: "<f4", 5123: "<u2"}[accessor["componentType"]]
        assert view["byteOffset"] % 4 == 0
        values = np.frombuffer(rest, dtype, accessor["count"] * width, 8 + view["byteOffset"])
        assert values.nbytes == view["byteLength"]
        found[name] = values.reshape(-1, width)
    return document, found


def written(path: Path, degree: int) -> StoredGaussians:
    rows = to_stored(cloud(degree=degree))
    write_glb(path, rows)
    return rows


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_values(tmp_path: Path, degree: int) -> None:
    rows = written(tmp_path / "a.glb", degree)
    document, found = decoded(tmp_path / "a.glb")
    np.testing.assert_array_equal(found["POSITION"], rows.means)
    np.testing.assert_array_equal(found[f"{PREFIX}SH_DEGREE_0_COEF_0"], rows.sh_dc)
    names = [f"{PREFIX}SH_DEGREE_{band}_COEF_{k}" for band, count in enumerate(COUNTS[degree]) for k in range(count)]
    assert [name for name in found if "SH_" in name] == names
    for index, name in enumerate(names[1:]):
        np.testing.assert_array_equal(found[name], rows.sh_rest[:, index])
    np.testing.assert_allclose(found[f"{PREFIX}SCALE"], np.exp(rows.log_scales), rtol=1e-6)
    opacities = 1 / (1 + np.exp(-rows.opacity_logits))
    np.testing.assert_allclose(found[f"{PREFIX}OPACITY"][:, 0], opacities, rtol=1e-6)
    quats = found[f"{PREFIX}ROTATION"]
    np.testing.assert_allclose(np.linalg.norm(quats, axis=1), 1, atol=1e-6)
    np.testing.assert_allclose(quats, rows.quats[:, [1, 2, 3, 0]], atol=1e-6)
    color = found["COLOR_0"] / 65535
    srgb = (0.5 + 0.28209479177387814 * rows.sh_dc).clip(0, 1)
    linear = color[:, :3]
    curve = np.where(linear > 0.0031308, 1.055 * linear ** (1 / 2.4) - 0.055, linear * 12.92)
    np.testing.assert_allclose(curve, srgb, atol=2e-4)
    np.testing.assert_allclose(color[:, 3], opacities, atol=1e-5)
    (primitive,) = document["meshes"][0]["primitives"]
    assert primitive["mode"] == 0
    assert primitive["extensions"] == {
        "KHR_gaussian_splatting": {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}
    }
    assert document["extensionsUsed"] == ["KHR_gaussian_splatting"] and "extensionsRequired" not in document
    position = document["accessors"][primitive["attributes"]["POSITION"]]
    assert position["min"] == rows.means.min(0).tolist() and position["max"] == rows.means.max(0).tolist()
    assert not list(tmp_path.glob(".*"))


def test_extremes_stay_valid(tmp_path: Path) -> None:
    """Opacities of 0 and 1, the smallest scale, quaternions of another length."""
    rows = StoredGaussians(
        means=np.zeros((2, 3), np.float32),
        sh_dc=np.array([[-9, 0, 9], [9, 9, 9]], np.float32),
        sh_rest=np.zeros((2, 0, 3), np.float32),
        opacity_logits=np.array([-80, 80], np.float32),
        log_scales=np.full((2, 3), -20.7, np.float32),
        quats=np.array([[0, 0, 0, 3e-6], [1e5, 0, 0, 0]], np.float32),
    )
    write_glb(tmp_path / "a.glb", rows)
    _, found = decoded(tmp_path / "a.glb")
    np.testing.assert_allclose(found[f"{PREFIX}OPACITY"][:, 0], [0, 1], atol=1e-30)
    np.testing.assert_allclose(found[f"{PREFIX}ROTATION"], [[0, 0, 1, 0], [0, 0, 0, 1]])
    assert (found[f"{PREFIX}SCALE"] >= 0).all() and found["COLOR_0"][0].tolist() == [0, 14027, 65535, 0]


def test_what_does_not_fit_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(glb, "MAX_FILE_BYTES", 1000)
    with pytest.raises(InputError, match="--format ply"):
        written(tmp_path / "a.glb", 0)
    assert not list(tmp_path.iterdir())


VALIDATE = """
const validator = require('gltf-validator');
const data = new Uint8Array(require('fs').readFileSync(process.argv[1]));
validator.validateBytes(data, {severityOverrides: {MESH_PRIMITIVE_INVALID_ATTRIBUTE: 3}}).then(report =>
  console.log(JSON.stringify(report)));
"""
READ = """
const { NodeIO } = require('@gltf-transform/core');
const extension = 'KHR_gaussian_splatting';
new NodeIO().readBinary(new Uint8Array(require('fs').readFileSync(process.argv[1]))).then(document => {
  const primitive = document.getRoot().listMeshes()[0].listPrimitives()[0];
  const found = {mode: primitive.getMode()};
  for (const name of primitive.listSemantics()) {
    const accessor = primitive.getAttribute(name);
    found[name] = [...Array(accessor.getCount()).keys()].map(index => accessor.getElement(index, []));
  }
  console.log(JSON.stringify(found));
});
"""


@pytest.mark.parametrize("degree", [0, 3])
def test_the_validator_of_khronos_finds_no_error(tmp_path: Path, degree: int) -> None:
    """It does not know the extension (issue 252 of glTF-Validator), whose attributes are therefore hints here."""
    written(tmp_path / "a.glb", degree)
    report = json.loads(node(VALIDATE, "gltf-validator", tmp_path / "a.glb"))
    issues = report["issues"]
    assert (issues["numErrors"], issues["numWarnings"]) == (0, 0), issues["messages"]
    allowed = {"MESH_PRIMITIVE_INVALID_ATTRIBUTE", "UNSUPPORTED_EXTENSION"}
    assert {message["code"] for message in issues["messages"]} <= allowed
    assert report["info"]["totalVertexCount"] == 60 and report["info"]["extensionsUsed"] == ["KHR_gaussian_splatting"]


@pytest.mark.parametrize("degree", [0, 3])
def test_an_independent_reader_finds_the_same_numbers(tmp_path: Path, degree: int) -> None:
    written(tmp_path / "a.glb", degree)
    read = json.loads(node(READ, "@gltf-transform/core", tmp_path / "a.glb").splitlines()[-1])
    _, ours = decoded(tmp_path / "a.glb")
    assert read.pop("mode") == 0 and set(read) == set(ours)
    for name, values in read.items():
        expected = ours[name] / 65535 if ours[name].dtype == np.uint16 else ours[name]
        np.testing.assert_array_equal(np.array(values), expected.astype(np.float64), err_msg=name)
