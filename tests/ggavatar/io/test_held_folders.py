"""What was removed while it was written does not come back, whichever writer is next and whatever took its place."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from ggavatar.io.atomic import write_text
from ggavatar.io.held_folders import hold_folder, make_folder


def remove(root: Path) -> None:
    shutil.rmtree(root)


def rename(root: Path) -> None:
    root.rename(root.with_name("renamed"))


def replace(root: Path) -> None:
    """Somebody begins anew under the same name."""
    rename(root)
    root.mkdir()


@pytest.mark.parametrize("happens", [remove, rename, replace])
@pytest.mark.parametrize("file", ["a.txt", "sub/a.txt", "sub/deeper/a.txt"])
def test_a_held_folder_does_not_come_back(tmp_path: Path, happens: Callable[[Path], None], file: str) -> None:
    root = tmp_path / "root"
    root.mkdir()
    with hold_folder(root):
        write_text(root / file, "1")
        happens(root)
        with pytest.raises(FileNotFoundError, match="removed or renamed") as error:
            write_text(root / file, "2")
        assert error.value.filename == str(root)
    assert not (root / file).exists()
    write_text(root / file, "3")
    assert (root / file).read_text() == "3", "it is only guarded while it is held"


def test_a_link_to_a_held_folder_is_the_same_folder(tmp_path: Path) -> None:
    root, link = tmp_path / "root", tmp_path / "link"
    root.mkdir()
    link.symlink_to(root)
    with hold_folder(link):
        write_text(root / "a" / "b.txt", "1")
        shutil.rmtree(root)
        with pytest.raises(FileNotFoundError):
            write_text(link / "a" / "b.txt", "2")
    assert not root.exists()


def test_folders_beside_a_held_one_are_made(tmp_path: Path) -> None:
    (tmp_path / "root").mkdir()
    with hold_folder(tmp_path / "root"):
        make_folder(tmp_path / "rooted" / "deep")
        make_folder(tmp_path / "root" / "deep" / "deeper")
    assert (tmp_path / "rooted" / "deep").is_dir() and (tmp_path / "root" / "deep" / "deeper").is_dir()


def test_the_inner_one_of_two_held_folders_may_go_but_not_come_back(tmp_path: Path) -> None:
    inner = tmp_path / "inner"
    inner.mkdir()
    with hold_folder(tmp_path), hold_folder(inner):
        inner.rmdir()
        with pytest.raises(FileNotFoundError):
            make_folder(inner / "deep")
        write_text(tmp_path / "other" / "a.txt", "1")
    assert not inner.exists()


def test_a_file_in_the_way_is_an_error_of_the_system(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with hold_folder(tmp_path), pytest.raises(OSError):
        make_folder(tmp_path / "file" / "folder")
