"""The content of a file decides its kind, whatever its name. Also covers `ggavatar/formats/source_options.py`."""

from __future__ import annotations

import dataclasses
import gzip
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from ggavatar.errors import InputError
from ggavatar.formats.gaussian_files import digest, read_gaussians
from ggavatar.formats.source_options import GaussianReadingOptions, is_gaussian_file, results_folder
from ggavatar.formats.splats.file_kinds import file_kind
from ggavatar.formats.splats.gaussian_ply import write_gaussian_ply
from ggavatar.formats.splats.glb import write_glb
from ggavatar.formats.splats.splat import write_splat
from ggavatar.formats.splats.spz import write_spz
from ggavatar.formats.splats.stored_gaussians import to_stored
from tests.support.gaussian_cloud import cloud
from tests.support.splat_files import SPZ_CODES, compressed_ply, sog, sog_1, sog_2, spz, zipped


@pytest.fixture(scope="module")
def contents(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[str, bytes, int]]:
    """Kind, content and number of Gaussians of a file of every variety."""
    folder, rows = tmp_path_factory.mktemp("kinds"), to_stored(cloud(20, 1))
    made = {}
    for kind, write in (("ply", write_gaussian_ply), ("splat", write_splat), ("spz", write_spz), ("glb", write_glb)):
        write(folder / "a", rows)
        made[kind] = (kind, (folder / "a").read_bytes(), 20)
    made["compressed"] = ("ply", compressed_ply()[1], 300)
    made |= {f"spz {version}": ("spz", spz(version, codes_of(version), 1), 3) for version in (1, 2, 3, 4)}
    made |= {f"sog {number}": ("sog", zipped(sog(*make())), 5) for number, make in ((1, sog_1), (2, sog_2))}
    return made


def codes_of(version: int) -> dict[str, list]:
    return (
        SPZ_CODES
        | ({"rotations": [[128, 128, 128]] * 3} if version < 3 else {})
        | ({"positions": [[0, 0, 0]] * 3} if version == 1 else {})
    )


KINDS = ["ply", "splat", "spz", "glb", "compressed", "spz 1", "spz 2", "spz 3", "spz 4", "sog 1", "sog 2"]


@pytest.mark.parametrize("name", ["a.ply", "a.splat", "a.dat", "a"])
@pytest.mark.parametrize("variety", KINDS)
def test_content_decides(tmp_path: Path, contents: dict, variety: str, name: str) -> None:
    kind, content, count = contents[variety]
    (tmp_path / name).write_bytes(content)
    assert file_kind(tmp_path / name) == kind and is_gaussian_file(tmp_path / name)
    if kind == "glb":
        with pytest.raises(InputError, match="found glTF binary"):
            read_gaussians(tmp_path / name)
    else:
        assert len(read_gaussians(tmp_path / name)) == count
    assert results_folder(tmp_path / name) == tmp_path / ("a" if "." in name else "a-results")


def test_unpacked_sog_and_what_is_none(tmp_path: Path) -> None:
    folder = tmp_path / "head"
    folder.mkdir()
    for name, content in sog(*sog_2()).items():
        (folder / name).write_bytes(content)
    assert file_kind(folder) == file_kind(folder / "meta.json") == "sog"
    assert results_folder(folder) == results_folder(folder / "meta.json") == folder
    np.testing.assert_array_equal(read_gaussians(folder).means, read_gaussians(folder / "meta.json").means)
    before = digest(folder)
    assert before == digest(folder / "meta.json") and len(before) == 64
    (folder / "renders").mkdir()
    assert digest(folder) == before
    (folder / "l.webp").write_bytes(b"other")
    assert digest(folder) != before
    (folder / "config.json").write_text("{}")
    assert file_kind(folder) is None, "a run, whatever else is in it"
    (tmp_path / "metrics.json").write_text(json.dumps({"means": 1, "summary": {}}))
    (tmp_path / "x.npz").write_bytes(zipped({"a.npy": b""}))
    (tmp_path / "zeros").write_bytes(bytes(320))
    (tmp_path / "x.gz").write_bytes(gzip.compress(b"text"))
    for path in ("metrics.json", "x.npz", "zeros", "x.gz", "nothing", ""):
        assert file_kind(tmp_path / path) is None, path
    assert file_kind(tmp_path / "missing.SPZ") == "spz" and results_folder(tmp_path / "missing.spz").name == "missing"
    (tmp_path / "levels.json").write_text(json.dumps({"lodLevels": 2, "tree": {}}))
    assert file_kind(tmp_path / "levels.json") == "sog"


@pytest.mark.parametrize(
    ("content", "options", "words"),
    [
        (None, {}, "no such file"),
        (b"not a file of Gaussians", {}, "expected a PLY file"),
        ("spz", {"scales": "linear"}, "--scales and --opacities belong to PLY"),
        ("sog 2", {"opacities": "logit"}, "this is SOG"),
    ],
)
def test_what_is_wrong_is_said(tmp_path: Path, contents: dict, content: object, options: dict, words: str) -> None:
    if content is not None:
        (tmp_path / "a.ply").write_bytes(content if isinstance(content, bytes) else contents[content][1])
    with pytest.raises(InputError, match=words):
        read_gaussians(tmp_path / "a.ply", dataclasses.replace(GaussianReadingOptions(), **options))


def test_is_decided_without_torch() -> None:
    code = "import sys, ggavatar.formats.source_options; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
