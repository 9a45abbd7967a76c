"""GGAvatar: an animatable 3D-Gaussian head avatar from a portrait video (Li et al., Pacific Graphics 2024).

The names in `__all__` are the public API (docs/api.md). Each is imported when it is first used, so that `import
ggavatar` and the commands' `--help` wait for nothing; types are in `__init__.pyi`. What `preprocess` and `evaluate`
contribute is found by the entry points of our own distribution, as this package imports neither. That is why the few
lines below stand here instead of the library lazy_loader, which knows modules of one package only.
"""

from __future__ import annotations

_OWN = {
    "Camera": "ggavatar.core",
    "Capture": "ggavatar.data.capture",
    "Drive": "ggavatar.core",
    "ExportResult": "ggavatar.formats.export",
    "Gaussians": "ggavatar.core",
    "InputError": "ggavatar.errors",
    "Performance": "ggavatar.api.performances",
    "Run": "ggavatar.training.run_folder",
    "drive": "ggavatar.api.performances",
    "export": "ggavatar.api.exporting",
    "list_methods": "ggavatar.api.runs",
    "open_capture": "ggavatar.api.runs",
    "open_run": "ggavatar.api.runs",
    "render_frames": "ggavatar.api.images",
    "render_performance": "ggavatar.api.images",
    "train": "ggavatar.api.runs",
}
"""Modules of our own names."""
_ENTRY_POINTS = "ggavatar.api"
_OTHERS = (
    "Diagnosis", "Evaluation", "Metric", "Table", "check_capture", "list_importers", "list_metrics", "make_demo",
    "make_tables", "prepare_capture", "read_scores", "score_folders", "score_pictures", "score_run", "write_tables",
    "write_video",
)  # fmt: skip
"""Names of `preprocess` and `evaluate`, which our distribution registers under `_ENTRY_POINTS`."""

__all__ = ["__version__", *sorted([*_OWN, *_OTHERS], key=str.casefold)]


def __getattr__(name: str) -> object:
    """A public name, imported now."""
    if name == "__version__":
        from importlib.metadata import version

        return version("ggavatar")
    if name in _OWN:
        from importlib import import_module

        found = getattr(import_module(_OWN[name]), name)
    elif name in _OTHERS:
        from ggavatar.plugins.entry_points import own_entry_points

        points = own_entry_points(_ENTRY_POINTS)
        if name not in points:
            raise ImportError(f"ggavatar.{name}: the installed package is older than this source; install it again")
        found = points[name].load()
    else:
        raise AttributeError(f"module 'ggavatar' has no attribute {name!r}")
    globals()[name] = found  # the next use does not come here
    return found


def __dir__() -> list[str]:
    """The public names."""
    return list(__all__)
