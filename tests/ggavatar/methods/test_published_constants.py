"""The constants of every method as literals; a preset for the published training may not differ from them.

Sources: the papers, and the public code of the baselines, by section or file. Where a paper is silent the choice is
numbered as in docs/paper.md (A1 to A34).
"""

from __future__ import annotations

from typing import Any

import pytest

from ggavatar.training import registry

THREE_DGS: dict[str, Any] = {
    # Kerbl et al. 2023 and their code, arguments/__init__.py
    "rotation_rate": 1e-3,
    "opacity_rate": 0.05,
    "color_rate": 2.5e-3,
    "sh_degree": 3,
    "sh_iterations": 1_000,
    "dssim_share": 0.2,
}

GGAVATAR: dict[str, Any] = THREE_DGS | {
    # Li et al. 2024, Sec. 3.5
    "neutral_iterations": 5_000,
    "position_rate": 5e-3,
    "position_decay": 0.01,
    "position_iterations": 60_000,
    "scale_rate": 5e-3,
    "density_start": 500,
    "density_stop": 60_000,
    "density_interval": 100,
    "reset_iterations": 3_000,
    "network_rate": 1e-4,
    "field_rate": 5e-3,
    # Eq. 13 to 16
    "perceptual_weight": 0.02,
    "perceptual_mode": "image",
    "position_weight": 0.01,
    "position_threshold": 1.0,
    "scale_weight": 1.0,
    "scale_threshold": 0.6,
    # Sec. 3.2, 3.3 and Table 2: what the full method has
    "initialization": True,
    "skinning": True,
    "adjuster": True,
    "field": "triplane",
    # 3DGS
    "density_gradient": 2e-4,
    "density_ramp": False,
    # A6, A8, A9, A12, A23 and NeRF's ten octaves
    "offset_unit": 0.01,
    "latent": 32,
    "hidden": 64,
    "latent_hidden": 128,
    "field_levels": 12,
    "field_features": 2,
    "field_finest": 512,
    "extent": 1.0,
    "octaves": 10,
}

GAUSSIAN_AVATARS: dict[str, Any] = THREE_DGS | {
    # Qian et al. 2024, Sec. 3.3, 3.4 and their code, arguments/__init__.py, train.py
    "finetuning": True,
    "expression_rate": 1e-3,
    "joint_rate": 1e-5,
    "translation_rate": 1e-6,
    "position_rate": 5e-3,
    "position_decay": 0.01,
    "scale_rate": 0.017,
    "position_weight": 0.01,
    "position_threshold": 1.0,
    "scale_weight": 1.0,
    "scale_threshold": 0.6,
    "density_gradient": 2e-4,
    "split_in": "local",
    # GGAvatar's Sec. 4.2: "trained under the same experimental conditions as ours"
    "iterations": 120_000,
    "position_iterations": 60_000,
    "density_start": 500,
    "density_stop": 60_000,
    "density_interval": 100,
    "reset_iterations": 3_000,
    # Sec. 4.2: "with an additional perceptual loss"
    "perceptual_weight": 0.02,
    "perceptual_mode": "image",
    "perceptual_share": 1 / 24,
}

FLASH_AVATAR: dict[str, Any] = {
    # Xiang et al. 2024 and their code, arguments/__init__.py, train.py, scene/deform_model.py
    "octaves": 8,
    "hidden": 256,
    "depth": 6,
    "network_rate": 1e-4,
    "scale_rate": 5e-3,
    "rotation_rate": 1e-3,
    "opacity_rate": 0.05,
    "color_rate": 2.5e-3,
    "sh_degree": 3,
    "sh_iterations": 500,
    "huber_delta": 0.1,
    "mouth_weight": 40.0,
    "perceptual_iterations": 15_000,
    # GGAvatar, Sec. 4.2: "we set the UV resolution of FlashAvatar to 256 and added the boundary"
    "texels": 256,
    "boundary": "keep",
}

GAUSSIAN_BLENDSHAPES: dict[str, Any] = THREE_DGS | {
    # Ma et al. 2024, Sec. 3.4, 4 and their code
    "iterations": 40_000,
    "first_gaussians": 50_000,
    "blendshapes": 50,
    "consistency": True,
    "position_rate": 1.6e-4,
    "position_decay": 0.01,
    "position_iterations": 30_000,
    "scale_rate": 5e-3,
    "position_difference_rate": 3.2e-7,
    "scale_difference_rate": 5e-4,
    "rotation_difference_rate": 1e-4,
    "opacity_difference_rate": 5e-5,
    "color_difference_rate": 1.25e-3,
    "difference_rate": 1.0,
    "density_start": 500,
    "density_stop": 15_000,
    "density_interval": 100,
    "density_gradient": 1e-3,
    "prune_iterations": 3_000,
    "alpha_weight": 10.0,
    "mouth_weight": 100.0,
}

POINT_AVATAR: dict[str, Any] = {
    # Zheng et al. 2023 and their code, confs/*.conf; GGAvatar's Sec. 4.2 for the number of points
    "points": 400,
    "sphere": 0.5,
    "radius_factor": 0.3,
    "max_points": 240_000,
    "epochs": 62,
    "upsampling_epochs": 5,
    "pruning_radius": 0.006,
    "rate": 1e-4,
    "tracking_rate": 5e-4,
    "tracking_epochs": 10,
    "jaw": 0.4,
    "surface_width": 256,
    "surface_layers": 9,
    "surface_octaves": 6,
    "mask_weight": 1.0,
    "perceptual_weight": 0.1,
    "perceptual_mode": "image",
    "distance_weight": 1.0,
    "eikonal_weight": 0.1,
    "neighbours": 0.25,
    "head_weight": 10.0,
    "head_milestones": (10, 20, 30, 40),
}

SPLATTING_AVATAR: dict[str, Any] = {
    # Shao et al. 2024, Sec. 3, Eq. 8 and 10, and their code, configs/splatting_avatar.yaml, splatting_avatar_optim.py,
    # loss_base.py; lengths divided by 4, the size of their FLAME, areas by 16
    "iterations": 30_000,
    "first_gaussians": 10_000,
    "first_places": "triangles",
    "first_colors": "grey",
    "walking": "lifted",
    "scale_by": "area",
    "area_damping": 1e-4 / 16,
    "walk_interval": 100,
    "walk_decay": 0.9,
    "displacement_rate": 1.6e-4 / 4,
    "walk_rate": 1.6e-4,
    "position_decay": 0.01,
    "scale_rate": 5e-3,
    "rotation_rate": 1e-3,
    "opacity_rate": 0.05,
    "color_rate": 2.5e-3,
    "density_start": 600,
    "density_stop": 29_000,
    "density_interval": 100,
    "density_gradient": 2e-4,
    "density_ramp": False,
    "reset_iterations": 3_000,
    "extent": 2.0 / 4,
    "split_along_normal": False,
    "mse_weight": 10.0,
    "scaling_weight": 1.0,
    "scaling_threshold": 0.008 / 4,
    "scaling_ratio": 10.0,
    "perceptual_mode": "image",
    # 0.01 of LPIPS, a tenth of our loss
    "perceptual_weight": 0.01 / 10,
}

PS_AVATAR: dict[str, Any] = THREE_DGS | {
    # Zhao et al. 2024 published no constants: these are those of 3DGS, of PointAvatar, and of GGAvatar's Sec. 4.2
    "iterations": 30_000,
    "first_places": "surface",
    "first_colors": "grey",
    "follow": "skin",
    "free": True,
    "corrections": True,
    "position_rate": 1.6e-4,
    "position_decay": 0.01,
    "scale_rate": 5e-3,
    "fine_prune_opacity": 0.005,
    "mask_weight": 1.0,
    "perceptual_weight": 0.02,
    "perceptual_mode": "image",
    # MonoGaussianAvatar
    "prune_opacity": 0.1,
    # ours
    "points": 100_000,
    "off_share": 0.5,
    "lowest_off_face": -0.005,
    "highest_off_face": 0.015,
    "highest_off_rest": 0.06,
    "stage_share": 0.25,
    "fine_position_rate": 1.6e-5,
    "basis_rate": 1e-4,
    "fine_basis_rate": 1e-5,
    "fine_mask_weight": 0.1,
}

PUBLISHED = {
    "ggavatar": GGAVATAR,
    "gaussian_avatars": GAUSSIAN_AVATARS,
    "flash_avatar": FLASH_AVATAR,
    "gaussian_blendshapes": GAUSSIAN_BLENDSHAPES,
    "point_avatar": POINT_AVATAR,
    "ps_avatar": PS_AVATAR,
    "splatting_avatar": SPLATTING_AVATAR,
}


@pytest.mark.parametrize("method", PUBLISHED)
def test_paper_preset_is_what_was_published(method: str) -> None:
    config = registry.load(method).config("paper")
    found = {name: getattr(config, name) for name in PUBLISHED[method]}
    assert found == PUBLISHED[method]
