"""ggavatar-export of a file: between all formats, by the command. Reference: the Gaussians that were written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ggavatar.cli.export import main
from ggavatar.formats.conversion import convert
from ggavatar.formats.gaussian_files import read_gaussians
from ggavatar.formats.source_options import GaussianReadingOptions
from ggavatar.formats.splats.gaussian_ply import read_gaussian_ply, write_gaussian_ply
from ggavatar.formats.splats.splat import write_splat
from ggavatar.formats.splats.spz import write_spz
from ggavatar.formats.splats.stored_gaussians import StoredGaussians, activate, to_stored
from tests.support.gaussian_cloud import cloud, psnr, render
from tests.support.splat_files import compressed_ply, ply, sog, sog_2, zipped

WRITERS = {"ply": write_gaussian_ply, "splat": write_splat, "spz": write_spz}


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str]:
    """Exit code and output of the command."""
    try:
        code = main([*map(str, arguments)])
    except SystemExit as leaving:
        code = int(leaving.code or 0)
    shown = capsys.readouterr()
    return code, shown.out + shown.err


@pytest.mark.parametrize("kind", ["ply", "splat", "spz"])
@pytest.mark.parametrize("to", ["ply", "splat", "spz"])
def test_heads_stay_upright(tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str, to: str) -> None:
    WRITERS[kind](tmp_path / f"from.{kind}", to_stored(cloud(degree=0)))
    code, shown = run(capsys, tmp_path / f"from.{kind}", "-o", tmp_path / f"to.{to}")
    assert code == 0 and f"wrote {tmp_path / f'to.{to}'} (60 Gaussians)" in shown
    found = activate(read_gaussians(tmp_path / f"to.{to}"))
    assert psnr(render(found), render(cloud(degree=0))) > 33


def test_default_names_formats_and_notes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a.sog").write_bytes(zipped(sog(*sog_2())))
    code, shown = run(capsys, tmp_path / "a.sog")
    assert code == 0 and (tmp_path / "a.ply").is_file() and "note: it is read in the axes of viewers" in shown
    assert f"next: ggavatar-render {tmp_path / 'a.ply'} --orbit" in shown
    np.testing.assert_allclose(read_gaussian_ply(tmp_path / "a.ply").means, read_gaussians(tmp_path / "a.sog").means)
    assert run(capsys, tmp_path / "a.sog", "--format", "glb")[0] == 0
    assert (tmp_path / "a.glb").read_bytes()[:4] == b"glTF"
    folder = tmp_path / "unpacked"
    folder.mkdir()
    for name, content in sog(*sog_2()).items():
        (folder / name).write_bytes(content)
    assert run(capsys, folder, "--axes", "world")[0] == 0
    world = read_gaussians(folder, GaussianReadingOptions(axes="world"))
    np.testing.assert_allclose(read_gaussian_ply(tmp_path / "unpacked.ply").means, world.means, atol=1e-7)
    assert run(capsys, folder / "meta.json", "--overwrite")[0] == 0
    (tmp_path / "c.ply").write_bytes(compressed_ply()[1])
    assert run(capsys, tmp_path / "c.ply", "-o", tmp_path / "d.spz")[0] == 0
    assert len(read_gaussians(tmp_path / "d.spz")) == 300


def test_what_spz_cannot_hold_is_said(tmp_path: Path) -> None:
    rows = to_stored(cloud(degree=0))
    rows.means[0, 0] = 3000
    write_gaussian_ply(tmp_path / "a.ply", rows)
    result = convert(tmp_path / "a.ply", GaussianReadingOptions(), "spz", tmp_path / "a.spz")
    assert result.notes == (".spz cannot store positions beyond ±2048 m, 1 Gaussians are moved there",)
    assert float(read_gaussians(tmp_path / "a.spz").means[0, 0]) == pytest.approx(2048, abs=1e-3)


def bound(path: Path) -> StoredGaussians:
    columns = {name: np.full(3, 0.1, np.float32) for name in "xyz"}
    columns |= {f"{name}_{index}": np.full(3, 0.5, np.float32) for name in ("f_dc", "scale") for index in range(3)}
    columns |= {f"rot_{index}": np.full(3, 0.5, np.float32) for index in range(4)}
    columns |= {"opacity": np.zeros(3, np.float32), "binding_0": np.arange(3, dtype=np.float32)}
    path.write_bytes(ply({"vertex": columns}))
    return read_gaussian_ply(path)


def test_refusals(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_gaussian_ply(tmp_path / "a.ply", to_stored(cloud()))
    before = (tmp_path / "a.ply").read_bytes()
    rows = bound(tmp_path / "bound.ply")
    assert rows.faces is not None and rows.notes == (), "scales in triangles may be positive logarithms"
    cases = [
        ((tmp_path / "a.ply",), "another file than the source"),
        ((tmp_path / "a.ply", "--overwrite"), "another file than the source"),
        ((tmp_path / "a.ply", "--frame", 3), "without --neutral, --frame"),
        ((tmp_path / "a.ply", "--format", "gaussian-avatars"), "is written as ply, splat, spz, glb"),
        ((tmp_path / "a.ply", "--format", "vhap"), "expected a capture folder"),
        ((tmp_path / "bound.ply", "-o", tmp_path / "b.spz"), "only --format ply keeps the binding"),
        ((tmp_path / "none.sog",), "no such file"),
        ((tmp_path, "--scales", "linear"), "expected a run folder"),
    ]
    for arguments, words in cases:
        code, shown = run(capsys, *arguments)
        assert code == 2 and words in shown and "Traceback" not in shown, shown
    assert (tmp_path / "a.ply").read_bytes() == before and not (tmp_path / "b.spz").exists()
    assert run(capsys, tmp_path / "bound.ply", "-o", tmp_path / "copy.ply")[0] == 0
    copied = read_gaussian_ply(tmp_path / "copy.ply")
    assert copied.faces is not None and copied.faces.tolist() == [0, 1, 2]
