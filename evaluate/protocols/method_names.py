"""Names of methods as tables and figures show them."""

from __future__ import annotations

from types import MappingProxyType

DISPLAY_NAMES = MappingProxyType(
    {
        "ggavatar": "GGAvatar",
        "gaussian_avatars": "GaussianAvatars",
        "flash_avatar": "FlashAvatar",
        "point_avatar": "PointAvatar",
        "splatting_avatar": "SplattingAvatar",
        "mono_gaussian_avatar": "MonoGaussianAvatar",
        "ggavatar_without_adjuster": "w/o Geometry Morph Adjuster",
        "ggavatar_without_triplane": "w/o tri-plane",
        "ggavatar_without_lbs": "w/o LBS",
        "ggavatar_without_initialization": "w/o initialization",
    }
)
"""Printed names of methods by their names on the command line, as in the paper; others are printed as they are."""


def display_name(method: str) -> str:
    """The name of a method as the tables print it."""
    return DISPLAY_NAMES.get(method.replace("-", "_"), method)
