"""The formats of static Gaussians that are written: ours, and those that other packages register.

A package registers a module with `write(stream, gaussians)`, which is given an open binary file and `StoredGaussians`
in our axes, and optionally `losses(gaussians)`, sentences on what the format cannot represent. The name of its entry
point is the suffix of its files. Listing the names imports neither torch nor any of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import IO, TYPE_CHECKING

from ggavatar.errors import InputError
from ggavatar.formats.avatar_suffix import SUFFIX as AVATAR_SUFFIX
from ggavatar.formats.splats.file_kinds import SUFFIXES
from ggavatar.io.atomic import write_atomically
from ggavatar.plugins.entry_points import SPLAT_FORMATS, Listed, Plugin, guarded, listed
from ggavatar.text.names import clean_text

if TYPE_CHECKING:
    from ggavatar.formats.splats.stored_gaussians import StoredGaussians

WEB, PAGE_SUFFIXES = "web", (".html", ".htm")
AVATAR = "avatar"
"""Formats of a whole avatar, and the suffixes of a page's file."""
OWN = ("ply", "splat", "spz", "glb")
"""Formats that we write."""
_OTHER_NAMES = ("sog", "web", "html", "htm", "avatar", "ggavatar", "gaussian-avatars", "nersemble-submission", "json")
"""Names and suffixes of ggavatar-export that mean something else."""


@dataclass(frozen=True)
class PluggedFormat:
    """A format of another package."""

    plugin: Plugin
    module: ModuleType

    def write(self, path: Path, rows: StoredGaussians) -> None:
        """Write Gaussians atomically; `InputError` if the package fails."""

        def fill(stream: IO[bytes]) -> None:
            with guarded(self.plugin, f"it wrote {path}"):
                self.module.write(stream, rows)

        write_atomically(path, fill)

    def losses(self, rows: StoredGaussians) -> list[str]:
        """What the format cannot represent, as sentences."""
        if not hasattr(self.module, "losses"):
            return []
        with guarded(self.plugin, "it was asked what it cannot store"):
            return [clean_text(str(sentence)) for sentence in self.module.losses(rows)]


def splat_formats() -> list[str]:
    """Names of all formats; those of other packages last."""
    return [*OWN, *sorted(_plugins().usable)]


def written_suffixes() -> dict[str, str]:
    """Formats by the suffix of their files; those that are only read are among them."""
    return {**SUFFIXES, **{f".{name}": name for name in splat_formats()}}


def chosen_format(name: str | None, output: Path | None) -> str:
    """The format to write: the one that is named, else that of the suffix of the output, else ply."""
    suffix = output.suffix.lower() if output is not None else ""
    of_suffix = {**written_suffixes(), **dict.fromkeys(PAGE_SUFFIXES, WEB), AVATAR_SUFFIX: AVATAR}.get(suffix, "ply")
    return name or (of_suffix if of_suffix in (*splat_formats(), WEB, AVATAR) else "ply")


def problems() -> dict[str, str]:
    """Why formats of other packages cannot be used, one sentence each, by name."""
    return dict(_plugins().problems)


def plugged_format(kind: str) -> PluggedFormat:
    """The format of another package.

    Raises:
        InputError: There is none of this name, or it cannot be imported.
    """
    plugins = _plugins()
    if kind not in plugins.usable and kind not in plugins.problems:
        raise InputError(f"expected one of the formats {', '.join(splat_formats())}, found {kind!r}")
    plugin = plugins.require(kind)
    return PluggedFormat(plugin, plugin.load("write"))


def _plugins() -> Listed:
    return listed(SPLAT_FORMATS, [*OWN, *_OTHER_NAMES])
