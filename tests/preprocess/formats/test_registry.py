"""Importers of other packages are detected and read like ours; a broken one is named and passed over.

The reference is the format `npz` of our own: the foreign importer reads files that ours wrote.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from ggavatar.errors import InputError
from ggavatar.plugins.entry_points import IMPORTERS
from preprocess.formats import registry
from preprocess.formats.importers import npz
from preprocess.options import PrepOptions
from tests.support.plugin_packages import install
from tests.support.synthetic_clip import moving_record

GOOD = '''"""Files of ours under another name."""
from pathlib import Path
from preprocess.formats.importers import npz
TITLE = "mine: a file with the suffix .mine"
def recognizes(path): return path.suffix == ".mine"
def read(path):
    return npz.read(path)
'''
FAILING = 'TITLE = "angry"\ndef recognizes(path): return {}["none"]\ndef read(path): return None\n'


@pytest.fixture
def take(tmp_path: Path) -> Path:
    """A tracking in a file that none of our importers knows."""
    path = tmp_path / "take.mine"
    npz.write(tmp_path / "take.npz", moving_record(4))
    (tmp_path / "take.npz").rename(path)
    return path


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty folder of installed packages."""
    monkeypatch.syspath_prepend(str(tmp_path / "site"))
    yield tmp_path / "site"
    for name in [name for name in sys.modules if name.startswith("of_a_test")]:
        del sys.modules[name]


def test_it_is_listed_detected_and_read(take: Path, site: Path) -> None:
    install(site, "mine", {"of_a_test_mine": GOOD}, {IMPORTERS: {"mine_tracker": "of_a_test_mine"}})
    assert "mine_tracker" in registry.importer_names() and "of_a_test_mine" not in sys.modules
    name, record = registry.read_tracking_record(PrepOptions(Path("v"), Path("o"), tracking=take))
    assert name == "mine_tracker"
    np.testing.assert_array_equal(record.expression, moving_record(4).expression)
    assert registry.importer("mine-tracker").TITLE.startswith("mine: ")


@pytest.mark.parametrize(
    ("source", "warning"),
    [
        (FAILING, r"failed when it looked at .*take.mine: KeyError: 'none' \(of_a_test_bad.py:2\)"),
        ("import no_such_module_of_a_test\n", "failed when it was imported: ModuleNotFoundError"),
        ("TITLE = 'half'\n", "found no recognizes, read"),
    ],
)
def test_a_broken_one_is_named_and_passed_over(
    source: str, warning: str, take: Path, site: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    install(site, "mine", {"of_a_test_mine": GOOD}, {IMPORTERS: {"mine": "of_a_test_mine"}})
    install(site, "bad", {"of_a_test_bad": source}, {IMPORTERS: {"bad": "of_a_test_bad", "npz": "of_a_test_bad"}})
    assert registry.detect_format(take) == "mine"
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 2 and all("of the package bad 1" in line for line in lines)
    with pytest.raises(InputError, match=warning):
        registry.importer("bad").recognizes(take)
    assert registry.importer("npz") is npz


def test_what_it_reads_has_to_be_a_tracking(take: Path, site: Path) -> None:
    install(site, "bad", {"of_a_test_bad": FAILING}, {IMPORTERS: {"bad": "of_a_test_bad"}})
    with pytest.raises(
        InputError, match=r"importer 'bad' of the package bad 1: expected a TrackingRecord of .* NoneType"
    ):
        registry.importer("bad").read(take)


def test_an_unknown_format_suggests_the_nearest() -> None:
    with pytest.raises(InputError, match=r"--format vhapp: expected auto or one of .*vhap, .*did you mean vhap\?"):
        registry.importer("vhapp")
