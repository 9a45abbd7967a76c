"""Display names of methods in tables and figures."""

from __future__ import annotations

from types import MappingProxyType

DISPLAY_NAMES = MappingProxyType(
    {
        "ggavatar": "GGAvatar",
        "gaussian_avatars": "GaussianAvatars",
        "flash_avatar": "FlashAvatar",
        "point_avatar": "PointAvatar",
        "gaussian_blendshapes": "Gaussian Blendshapes",
        "splatting_avatar": "SplattingAvatar",
        "splatting_avatar_code": "SplattingAvatar (public code)",
        "splatting_avatar_without_walk": "SplattingAvatar w/o walk",
        "splatting_avatar_without_area": "SplattingAvatar w/o area",
        "ps_avatar": "PSAvatar",
        "ps_avatar_normal": "PSAvatar along normals",
        "ps_avatar_onsurface": "PSAvatar on the skin only",
        "ps_avatar_pinned": "PSAvatar pinned",
        "ps_avatar_without_corrections": "PSAvatar w/o corrections",
        "mono_gaussian_avatar": "MonoGaussianAvatar",
        "ggavatar_without_adjuster": "w/o Geometry Morph Adjuster",
        "ggavatar_without_triplane": "w/o tri-plane",
        "ggavatar_without_lbs": "w/o LBS",
        "ggavatar_without_initialization": "w/o initialization",
        "ggavatar_plus": "GGAvatar+ (ours)",
        "ggavatar_plus_without_torso": "GGAvatar+ w/o torso",
        "ggavatar_plus_without_pose": "GGAvatar+ w/o pose condition",
        "ggavatar_plus_without_colour": "GGAvatar+ w/o color rows",
        "ggavatar_plus_without_regions": "GGAvatar+ w/o region weights",
        "ggavatar_plus_without_alpha": "GGAvatar+ w/o coverage",
        "ggavatar_plus_full_perceptual": "GGAvatar+ with the paper's λ2",
    }
)
"""Names as in the paper, by method name on the command line (with underscores)."""


def display_name(method: str) -> str:
    """A method's name in tables and figures; methods that are not listed keep their own."""
    return DISPLAY_NAMES.get(method.replace("-", "_"), method)
