"""Packages with entry points, as pip leaves them in a folder: modules, and their metadata."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path


def install(
    folder: Path, package: str, modules: Mapping[str, str], entries: Mapping[str, Mapping[str, str]], version: str = "1"
) -> Path:
    """Put a package of single-file modules into a folder, which the caller prepends to `sys.path`.

    Args:
        folder: What stands for site-packages.
        package: Name of the distribution.
        modules: Sources by module name; a dot makes a package folder.
        entries: Targets by name by entry-point group.
        version: Of the distribution.
    """
    for name, source in modules.items():
        path = folder.joinpath(*name.split(".")).with_suffix(".py")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(source, encoding="utf-8")
    about = folder / f"{package.replace('-', '_')}-{version}.dist-info"
    about.mkdir(parents=True)
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: {version}\n")
    groups = (
        f"[{group}]\n" + "".join(f"{name} = {target}\n" for name, target in points.items())
        for group, points in entries.items()
    )
    (about / "entry_points.txt").write_text("\n".join(groups))
    return folder
