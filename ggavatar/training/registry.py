"""The registry of methods: each file in `ggavatar/methods/` is one, and each module that a package registers.

A file is named by its stem, a module by its entry point (`ggavatar.plugins`). Either defines `Config` (a frozen
dataclass), `build(config, scene) -> Avatar` and `VARIANTS` (overrides of Config by variant; each is a further method,
named `method_variant`). It may define `PRESETS` (overrides of Config by preset), `rasterizer(device, backend)` (a
renderer of its own), `least_gaussians(head)` (the smallest number it can work with) and `TABLE_NOTES` (sentences below
every table that shows the method, such as where it deviates from its paper). Names, descriptions and notes are read
from the source, so that listing them imports no method; a method is imported when it is used.
"""

from __future__ import annotations

import ast
import importlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from ggavatar.errors import InputError, nearest
from ggavatar.io.dataclass_json import from_plain, override
from ggavatar.io.regular_files import read_file
from ggavatar.plugins.entry_points import METHODS, Listed, Plugin, listed, source_of
from ggavatar.text.names import clean_text
from ggavatar.training.preset_rule import check_preset

METHODS_FOLDER = Path(__file__).parents[1] / "methods"
MAX_SOURCE_BYTES = 1 << 22
"""Largest source of a method that is read for its description."""


@dataclass(frozen=True)
class Method:
    """A method or one of its variants.

    Attributes:
        name: Its name on the command line.
        module: The imported file.
        overrides: Fields of `Config` that the variant changes.
        plugin: What another package registers; None for a method of our own.
    """

    name: str
    module: ModuleType
    overrides: Mapping[str, Any]
    plugin: Plugin | None = None

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences below every table that shows the method."""
        return tuple(getattr(self.module, "TABLE_NOTES", ()))

    def config(self, preset: str = "default", assignments: Sequence[str] = ()) -> Any:
        """The configuration for a preset, with the overrides of the variant and then the user's `name=value` texts."""
        preset_values = getattr(self.module, "PRESETS", {}).get(preset, {})
        check_preset(f"method {self.name}, preset {preset}", preset_values)
        config = self.module.Config(**{**preset_values, **self.overrides})
        return override(config, assignments, f"method {self.name}") if assignments else config

    def config_from(self, values: Mapping[str, Any], where: str) -> Any:
        """A configuration from JSON values; `where` names their source in the message of an `InputError`."""
        return from_plain(self.module.Config, values, where)

    def build(self, config: Any, scene: Any) -> Any:
        """The avatar before its first step."""
        return self.module.build(config, scene)

    def least_gaussians(self, head: Any) -> int:
        """The smallest number of Gaussians the method can have on a head: what its file says, else 1."""
        return int(getattr(self.module, "least_gaussians", lambda _: 1)(head))

    def rasterizer(self, device: str, backend: str) -> Any:
        """The renderer of its avatars: the method's own if its file defines one, else that of the device."""
        from ggavatar.render.backends import pick  # torch, which names() does without

        return getattr(self.module, "rasterizer", pick)(device, backend)


@dataclass(frozen=True)
class _Source:
    """What the source of a method says: its description and the names of its variants."""

    path: Path
    description: str
    variants: tuple[str, ...]
    plugin: Plugin | None = None

    def names(self, stem: str) -> dict[str, str]:
        """Every command-line name with its description, variants after their method."""
        variants = {f"{stem}_{variant}": f"{stem}, {variant.replace('_', ' ')}" for variant in self.variants}
        return {stem: self.description, **variants}


def names() -> dict[str, str]:
    """Every command-line name with its one-line description, in alphabetical order, variants after their method."""
    sources, _ = _sources()
    return {name: text for stem in sorted(sources) for name, text in sources[stem].names(stem).items()}


def problems() -> dict[str, str]:
    """Why methods of other packages cannot be used, one sentence each, by name."""
    return _sources()[1]


def load(name: str) -> Method:
    """Import a method by its command-line name.

    Raises:
        InputError: There is no such method, and the message suggests the nearest name; or it is that of another
            package and cannot be imported.
    """
    check_name(name)
    stem, source = _source_of_name(name)
    if source.plugin is None:
        module = importlib.import_module(f"ggavatar.methods.{stem}")
    else:
        module = source.plugin.load("Config", "build")
    overrides = {} if name == stem else module.VARIANTS[name.removeprefix(stem + "_")]
    return Method(name, module, overrides, source.plugin)


def load_as_trained(name: str, package: object, folder: Path) -> Method:
    """The method of a run.

    Args:
        name: Its name.
        package: Name and version of the package that the run says it is from; None for our own.
        folder: The run.

    Raises:
        InputError: There is no such method, for instance since its package is not installed.
    """
    if isinstance(package, Mapping) and name not in {**names(), **problems()}:
        named = clean_text(f"{package.get('name')} {package.get('version')}")
        raise InputError(
            f"{folder}: expected the package {named}, whose method {name} trained it, found no such method; install "
            "the package"
        )
    return load(name)


def table_notes(name: str) -> tuple[str, ...]:
    """The notes of a method or variant for tables; none for unknown methods. Imports no method if they are literals."""
    if name not in names():
        return ()
    _, source = _source_of_name(name)
    for node in _syntax(source.path).body:
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        if any(isinstance(target, ast.Name) and target.id == "TABLE_NOTES" for target in targets):
            try:
                return tuple(ast.literal_eval(getattr(node, "value", None) or ast.Tuple([], ast.Load())))
            except ValueError:
                return load(name).notes  # computed, so that the source does not say it
    return ()


def check_name(name: str) -> None:
    """Raise an `InputError` that suggests the nearest name if there is no method of this name."""
    known = names()
    if name in known:
        return
    unusable = problems()
    if name in unusable:
        raise InputError(unusable[name])
    raise InputError(
        f"unknown method {name!r}{nearest(name, known)}; known methods are {', '.join(known)}. Install the package "
        "of a method that is not among them"
    )


def _sources() -> tuple[dict[str, _Source], dict[str, str]]:
    """Sources of all methods by stem, and why methods of other packages are left out."""
    paths = (path for path in sorted(METHODS_FOLDER.glob("*.py")) if not path.stem.startswith("_"))
    found = {path.stem: _Source(path, *_describe(path)) for path in paths}
    plugins = listed(METHODS, found)
    unusable = dict(plugins.problems)
    taken = {name: "ggavatar" for stem, source in found.items() for name in source.names(stem)}
    for stem, source in _plugin_sources(plugins, unusable).items():
        own = source.names(stem)
        if clash := next((name for name in own if name in taken), None):
            unusable[stem] = (
                f"{source.plugin} is left out: {taken[clash]} has a method {clash!r} too; its author has to rename it"
            )
        else:
            found[stem] = source
            taken |= dict.fromkeys(own, str(source.plugin))
    return found, unusable


def _plugin_sources(plugins: Listed, unusable: dict[str, str]) -> dict[str, _Source]:
    """Sources of other packages' methods by name; adds to `unusable` why one cannot be read."""
    found = {}
    for name, plugin in plugins.usable.items():
        path = source_of(plugin.module)
        try:
            found[name] = _Source(path, *_describe(path), plugin) if path is not None else None
        except (InputError, OSError, SyntaxError, ValueError) as error:
            unusable[name] = f"{plugin} is left out: its source cannot be read ({error}); update {plugin.package}"
            continue
        if path is None:
            unusable[name] = f"{plugin} is left out: no module {plugin.module} is installed; update {plugin.package}"
    return {name: source for name, source in found.items() if source is not None}


def _source_of_name(name: str) -> tuple[str, _Source]:
    """Stem and source of a known method or variant."""
    sources, _ = _sources()
    return next((stem, source) for stem, source in sources.items() if name in source.names(stem))


def _syntax(path: Path) -> ast.Module:
    return ast.parse(read_file(path, MAX_SOURCE_BYTES, "the source of a method"), str(path))


def _describe(path: Path) -> tuple[str, tuple[str, ...]]:
    """First line of a method's docstring and the names of its variants, without importing it."""
    tree = _syntax(path)
    variants: list[str] = []
    for node in tree.body:
        if isinstance(node, (ast.Assign, ast.AnnAssign)) and isinstance(node.value, ast.Dict):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            if any(isinstance(target, ast.Name) and target.id == "VARIANTS" for target in targets):
                variants = [
                    key.value for key in node.value.keys if isinstance(key, ast.Constant) and isinstance(key.value, str)
                ]
    return (ast.get_docstring(tree) or "").split("\n")[0], tuple(variants)
