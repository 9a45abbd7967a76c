"""Plug-ins: what installed packages register under an entry-point group, listed without importing any of them.

One that cannot be used never hides the others: it is left out, and `Listed.problems` says in one line whose it is and
why. It is imported when its name is used.
"""

from __future__ import annotations

import contextlib
import importlib.metadata
import importlib.util
import re
import sys
import traceback
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from importlib.machinery import ModuleSpec
from pathlib import Path
from typing import Any

from ggavatar.errors import InputError

METHODS, IMPORTERS, METRICS = "ggavatar.methods", "ggavatar.importers", "ggavatar.metrics"
CAPTURE_FORMATS, SPLAT_FORMATS = "ggavatar.capture_formats", "ggavatar.splat_formats"
KINDS: Mapping[str, str] = {
    METHODS: "method",
    IMPORTERS: "importer",
    METRICS: "metric",
    CAPTURE_FORMATS: "capture format",
    SPLAT_FORMATS: "splat format",
}
"""What the groups register, in words."""
OURSELVES = "ggavatar"
"""The distribution whose entry points are no plug-ins."""
_WORD = re.compile(r"[a-z][a-z0-9_]{0,63}")
_FORMAT = re.compile(r"[a-z0-9][a-z0-9_-]{0,63}")
_OWN_FOLDER = str(Path(__file__).parent)


@dataclass(frozen=True)
class Plugin:
    """A plug-in that is installed.

    Attributes:
        group: The entry-point group, one of `KINDS`.
        name: Its name in the group.
        target: What is registered, as `module` or `module:attribute`.
        package: Name of the package that brings it.
        version: Of that package.
    """

    group: str
    name: str
    target: str
    package: str
    version: str

    def __str__(self) -> str:
        """Kind, name and package, for messages."""
        return f"{KINDS[self.group]} {self.name!r} of the package {self.package} {self.version}"

    @property
    def module(self) -> str:
        """The module that is imported."""
        return self.target.partition(":")[0].strip()

    def load(self, *attributes: str) -> Any:
        """Import what is registered.

        Args:
            *attributes: Names that it must have.

        Raises:
            InputError: It cannot be imported, or lacks an attribute.
        """
        point = importlib.metadata.EntryPoint(self.name, self.target, self.group)
        with guarded(self, "it was imported"):
            found = point.load()
        missing = [name for name in attributes if not hasattr(found, name)]
        if missing:
            raise InputError(
                f"{self}: expected {self.target} to define {', '.join(attributes)}, found no {', '.join(missing)}; "
                f"update {self.package}, or uninstall it"
            )
        return found


@dataclass(frozen=True)
class Listed:
    """The plug-ins of a group.

    Attributes:
        usable: Those that can be imported when they are used, by name.
        problems: Why others are left out, by name: a sentence that names the package.
    """

    usable: Mapping[str, Plugin]
    problems: Mapping[str, str]

    def require(self, name: str) -> Plugin:
        """The plug-in of a name that is known to be in the group; `InputError` with its problem if it has one."""
        if name in self.problems:
            raise InputError(self.problems[name])
        return self.usable[name]


def listed(group: str, own: Collection[str] = ()) -> Listed:
    """The plug-ins of a group.

    Args:
        group: One of `KINDS`.
        own: Names that are taken by the project itself.
    """
    claims: dict[str, list[Plugin]] = {}
    for point, package, version in _points(group):
        if package != OURSELVES:
            plugin = Plugin(group, point.name, point.value, package, version)
            claims.setdefault(point.name.replace("-", "_"), []).append(plugin)
    usable, problems = {}, {}
    taken = {name.replace("-", "_") for name in own}
    for key, plugins in claims.items():
        if problem := _problem(plugins, key in taken):
            problems[plugins[0].name] = problem
        else:
            usable[plugins[0].name] = plugins[0]
    return Listed(usable, problems)


def own_entry_points(group: str) -> dict[str, importlib.metadata.EntryPoint]:
    """What our own distribution registers under a group, by name."""
    return {point.name: point for point, package, _ in _points(group) if package == OURSELVES}


def _problem(plugins: list[Plugin], is_taken: bool) -> str:
    """Why the plug-ins of one name cannot be used; empty if the only one can."""
    first = plugins[0]
    is_format = first.group in (CAPTURE_FORMATS, SPLAT_FORMATS)
    if not (_FORMAT if is_format else _WORD).fullmatch(first.name):
        signs = "small letters, digits, - and _" if is_format else "small letters, digits and _, a letter first"
        return f"{first} is left out: expected a name of {signs}; its author has to rename it"
    if is_taken:
        return f"{first} is left out: ggavatar has a {KINDS[first.group]} of this name; its author has to rename it"
    if len(plugins) > 1:
        packages = " and ".join(sorted(f"{plugin.package} {plugin.version}" for plugin in plugins))
        return f"{KINDS[first.group]} {first.name!r} is left out: {packages} both register it; uninstall one of them"
    return ""


def _points(group: str) -> Iterator[tuple[importlib.metadata.EntryPoint, str, str]]:
    """Entry points with name and version of their packages, sorted by both."""
    found = []
    for point in _in_all_packages(group):
        distribution = getattr(point, "dist", None)
        name = distribution.name if distribution else "(unknown)"
        found.append((point, name, distribution.version if distribution else ""))
    return iter(sorted(found, key=lambda entry: (entry[0].name, entry[1])))


def _in_all_packages(group: str) -> list[importlib.metadata.EntryPoint]:
    """The entry points of a group; packages whose metadata cannot be read are passed over."""
    with contextlib.suppress(Exception):  # whatever the metadata of any installed package raises
        return list(importlib.metadata.entry_points(group=group))
    found: dict[str, list[importlib.metadata.EntryPoint]] = {}
    for distribution in importlib.metadata.distributions():
        with contextlib.suppress(Exception):
            found.setdefault(distribution.name, list(distribution.entry_points.select(group=group)))
    return [point for points in found.values() for point in points]


def source_of(module: str) -> Path | None:
    """The source file of a module that is not imported, nor are the packages it is in; None if it is not found."""
    places: list[str] | None = None
    spec: ModuleSpec | None = None
    parts = module.split(".")
    for count in range(1, len(parts) + 1):
        spec = _spec(".".join(parts[:count]), places)
        if spec is None:
            return None
        places = list(spec.submodule_search_locations or [])
    is_file = spec is not None and spec.has_location and spec.origin is not None
    return Path(str(spec.origin)) if is_file and spec is not None else None


def _spec(name: str, places: list[str] | None) -> ModuleSpec | None:
    """The spec of a module below `places`, which `importlib.util.find_spec` would import its parents for."""
    for finder in sys.meta_path:
        find = getattr(finder, "find_spec", None)
        found = None
        with contextlib.suppress(Exception):
            found = find(name, places) if find else None
        if found is not None:
            return found
    return None


@contextlib.contextmanager
def guarded(plugin: Plugin, doing: str) -> Iterator[None]:
    """Turn what goes wrong inside a plug-in into one line that names it and the line of its code.

    Raises:
        InputError: The block raised another exception than `InputError`, or one of the machine's (files, memory).
    """
    try:
        yield
    except (InputError, MemoryError, KeyboardInterrupt):
        raise
    except OSError as error:
        if error.filename is not None or error.errno is not None:
            raise
        raise InputError(failure(plugin, doing, error)) from error
    except (Exception, SystemExit) as error:
        raise InputError(failure(plugin, doing, error)) from error


def failure(plugin: Plugin, doing: str, error: BaseException) -> str:
    """One line that says which plug-in failed, how, and where in its code."""
    steps = [step for step in traceback.extract_tb(error.__traceback__) if _is_foreign(step.filename)]
    where = f" ({Path(steps[-1].filename).name}:{steps[-1].lineno})" if steps else ""
    said = " ".join(str(error).split())[:300]
    return (
        f"{plugin}: failed when {doing}: {type(error).__name__}: {said}{where}; update {plugin.package}, uninstall it, "
        "or tell its author"
    )


def _is_foreign(filename: str) -> bool:
    return not (filename.startswith((_OWN_FOLDER, "<frozen")) or "importlib" in filename)
