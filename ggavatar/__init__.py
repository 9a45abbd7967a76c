"""GGAvatar: an animatable 3D-Gaussian head avatar from a portrait video (Li et al., Pacific Graphics 2024)."""

from __future__ import annotations

__all__ = ["__version__"]


def __getattr__(name: str) -> str:
    """The version, looked up when it is asked for: a command's `--help` does not wait for it."""
    if name == "__version__":
        from importlib.metadata import version

        return version("ggavatar")
    raise AttributeError(f"module 'ggavatar' has no attribute {name!r}")
