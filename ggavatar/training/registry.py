"""The registry of methods: each file in `ggavatar/methods/` is a method named after the file.

A method's file defines `Config` (a frozen dataclass), `build(config, scene) -> Avatar` and `VARIANTS` (overrides of
Config by variant; each is a further method, named `file_variant`). It may define `PRESETS` (overrides of Config by
preset), `rasterizer(device, backend)` (a renderer of its own), `least_gaussians(head)` (the smallest number it can work
with) and `TABLE_NOTES` (sentences below every table that shows the method, such as where it deviates from its paper).
Names, descriptions and notes are read from the source, so that listing them imports no method; a method is imported
when it is used.
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
from ggavatar.training.preset_rule import check_preset

METHODS_FOLDER = Path(__file__).parents[1] / "methods"


@dataclass(frozen=True)
class Method:
    """A method or one of its variants.

    Attributes:
        name: Its name on the command line.
        module: The imported file.
        overrides: Fields of `Config` that the variant changes.
    """

    name: str
    module: ModuleType
    overrides: Mapping[str, Any]

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


def names() -> dict[str, str]:
    """Every command-line name with its one-line description, in alphabetical order, variants after their method."""
    found = {}
    for path in sorted(METHODS_FOLDER.glob("*.py")):
        if not path.stem.startswith("_"):
            description, variants = _describe(path)
            found[path.stem] = description
            found.update(
                {f"{path.stem}_{variant}": f"{path.stem}, {variant.replace('_', ' ')}" for variant in variants}
            )
    return found


def load(name: str) -> Method:
    """Import a method by its command-line name.

    Raises:
        InputError: There is no such method; the message suggests the nearest name.
    """
    check_name(name)
    stem = _stem(name)
    module = importlib.import_module(f"ggavatar.methods.{stem}")
    return Method(name, module, {} if name == stem else module.VARIANTS[name.removeprefix(stem + "_")])


def _stem(name: str) -> str:
    """The file of a known method or variant, without suffix."""
    stems = (path.stem for path in METHODS_FOLDER.glob("*.py"))
    return max((stem for stem in stems if name == stem or name.startswith(stem + "_")), key=len)


def table_notes(name: str) -> tuple[str, ...]:
    """The notes of a method or variant for tables; none for unknown methods. Imports no method if they are literals."""
    if name not in names():
        return ()
    path = METHODS_FOLDER / f"{_stem(name)}.py"
    for node in ast.parse(path.read_text(encoding="utf-8"), str(path)).body:
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
    if name not in known:
        raise InputError(f"unknown method {name!r}{nearest(name, known)}; known methods are {', '.join(known)}")


def _describe(path: Path) -> tuple[str, list[str]]:
    """First line of a method's docstring and the names of its variants, without importing it."""
    tree = ast.parse(path.read_text(encoding="utf-8"), str(path))
    variants: list[str] = []
    for node in tree.body:
        if isinstance(node, (ast.Assign, ast.AnnAssign)) and isinstance(node.value, ast.Dict):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            if any(isinstance(target, ast.Name) and target.id == "VARIANTS" for target in targets):
                variants = [
                    key.value for key in node.value.keys if isinstance(key, ast.Constant) and isinstance(key.value, str)
                ]
    return (ast.get_docstring(tree) or "").split("\n")[0], variants
