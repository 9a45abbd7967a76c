"""Formats of other packages are written by ggavatar-export like ours.

Also covers `ggavatar/formats/capture_layouts.py`. The reference is the text that the foreign writer makes of known
Gaussians.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from ggavatar.cli.export import main
from ggavatar.data.capture import Capture
from ggavatar.errors import InputError
from ggavatar.formats.capture_layouts import capture_formats, export_capture
from ggavatar.formats.splat_formats import OWN, plugged_format, splat_formats
from ggavatar.formats.splats.gaussian_ply import write_gaussian_ply
from ggavatar.formats.splats.stored_gaussians import to_stored
from ggavatar.plugins.entry_points import CAPTURE_FORMATS, SPLAT_FORMATS
from tests.support.gaussian_cloud import cloud
from tests.support.plugin_packages import install

XYZ = """
def write(stream, gaussians):
    for mean in gaussians.means:
        stream.write(("%.4f %.4f %.4f\\n" % tuple(mean)).encode())


def losses(gaussians):
    return ["only positions are kept"]
"""


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., None]]:
    """Installs a module as a splat format or, with `group`, as something else."""
    monkeypatch.syspath_prepend(str(tmp_path / "site"))

    def put(source: str, name: str = "xyz", group: str = SPLAT_FORMATS, target: str = "of_a_test_format") -> None:
        install(tmp_path / "site", "mine", {"of_a_test_format": source}, {group: {name: target}})

    yield put
    sys.modules.pop("of_a_test_format", None)


@pytest.fixture
def source(tmp_path: Path) -> Path:
    """A PLY with a few Gaussians."""
    write_gaussian_ply(tmp_path / "cloud.ply", to_stored(cloud(degree=0)))
    return tmp_path / "cloud.ply"


@pytest.mark.parametrize("flags", [["-o", "out.xyz"], ["--format", "xyz", "-o", "out.xyz"]])
def test_it_is_written_by_name_and_by_suffix(
    flags: list[str],
    site: Callable[..., None],
    source: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    site(XYZ)
    monkeypatch.chdir(source.parent)
    assert splat_formats() == [*OWN, "xyz"] and "of_a_test_format" not in sys.modules
    assert main([str(source), *flags]) == 0
    written = np.loadtxt("out.xyz", ndmin=2)
    np.testing.assert_allclose(written, to_stored(cloud(degree=0)).means, atol=1e-4)
    out = capsys.readouterr().out
    assert "note: only positions are kept" in out and "ggavatar-render" not in out


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("def write(stream, gaussians): stream.write('text')\n", r"failed when it wrote .*TypeError: a bytes-like"),
        ("def losses(rows): return []\n", "found no write"),
        ("1 / 0\n", r"ZeroDivisionError: division by zero \(of_a_test_format.py:1\)"),
    ],
)
def test_a_broken_one_leaves_no_file_and_no_traceback(
    text: str, message: str, site: Callable[..., None], source: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    site(text)
    assert main([str(source), "-o", str(source.with_name("out.xyz"))]) == 2
    error = capsys.readouterr().err
    assert "splat format 'xyz' of the package mine 1" in error and "Traceback" not in error
    with pytest.raises(InputError, match=message):
        plugged_format("xyz").write(source.with_name("out.xyz"), to_stored(cloud(degree=0)))
    assert not [path for path in source.parent.iterdir() if path.name.startswith((".out", "out"))]
    assert main([str(source), "-o", str(source.with_name("out.spz"))]) == 0


@pytest.mark.parametrize("name", ["ply", "html", "sog", "X Y"])
def test_names_that_mean_something_else_are_refused(
    name: str, site: Callable[..., None], source: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    site(XYZ, name)
    assert splat_formats() == list(OWN)
    code = main([str(source), "--format", name, "-o", str(source.with_name("out"))])
    assert (code, "mine 1 is left out" in capsys.readouterr().err) == (2, True)


def test_a_capture_layout_of_another_package(site: Callable[..., None], toy_capture: Capture, tmp_path: Path) -> None:
    site(
        "def write(capture, folder):\n    (folder / 'n.txt').write_text(capture.subject)\n    return {'frames': 3}\n",
        "names", CAPTURE_FORMATS, "of_a_test_format:write",
    )  # fmt: skip
    assert {"names", "vhap"} <= set(capture_formats())
    assert export_capture(toy_capture, "names", tmp_path / "out", overwrite=False) == {"frames": 3}
    assert (tmp_path / "out" / "n.txt").read_text() == "egg"


def test_a_broken_capture_layout(site: Callable[..., None], toy_capture: Capture, tmp_path: Path) -> None:
    site("def write(capture, folder): return None\n", "names", CAPTURE_FORMATS, "of_a_test_format:write")
    with pytest.raises(InputError, match="capture format 'names' of the package mine 1: expected a report"):
        export_capture(toy_capture, "names", tmp_path / "out", overwrite=False)
    assert not (tmp_path / "out").exists()
    with pytest.raises(InputError, match=r"found 'vhapp' \(did you mean vhap\?\)"):
        export_capture(toy_capture, "vhapp", tmp_path / "out", overwrite=False)
