"""The rule for presets: what a preset of a method may change, so that a row named after a paper is that paper's method.

A preset adapts a method to a short training. It may change lengths, learning rates, budgets and initial values, the
same for every method. It never changes what is modeled, what the networks see or what is minimized: such a change is a
method of its own (`ggavatar_plus`) or a variant, which has its own name in every table.
"""

from __future__ import annotations

from collections.abc import Iterable

PRESET_FIELDS: dict[str, tuple[str, ...]] = {
    "length": (
        "iterations",
        "position_iterations",
        "sh_iterations",
        "density_start",
        "density_stop",
        "density_interval",
        "reset_iterations",
        "pruning_frames",
    ),
    "learning rate": (
        "position_rate",
        "fine_position_rate",
        "basis_rate",
        "fine_basis_rate",
        "displacement_rate",
        "walk_rate",
        "scale_rate",
        "color_rate",
        "network_rate",
        "difference_rate",
        "rate",
        "rate_left",
    ),
    "budget": (
        "max_points",
        "points",
        "texels",
        "room_power",
        "sh_degree",
        "difference_sh_degree",
        "density_gradient",
        "density_ramp",
        "perceptual_mode",
        "crop_side",
        "crop_probability",
        "regularised",
        "surface_width",
        "surface_layers",
        "hidden_type",
    ),
    "initial value": ("first_colors", "first_places", "first_offsets", "begin", "fitting_steps", "radius_factor"),
    "perceptual features": ("perceptual_features",),
}
"""Names of the fields of a method's `Config` that a preset may change, by kind.

Crops of the perceptual loss count as a budget: their expected weight is that of the whole image. The perceptual
features are those of VGG16, or an untrained stand-in where VGG16 cannot be had; every table names them.
"""


def check_preset(where: str, names: Iterable[str]) -> None:
    """Raise an error unless a preset may change all fields of these names.

    Args:
        where: The method and the preset, for the message.
        names: Fields that the preset changes.

    Raises:
        ValueError: A field is not in `PRESET_FIELDS`: the author of a method has to make the change a variant.
    """
    allowed = {name for kind in PRESET_FIELDS.values() for name in kind}
    others = sorted(set(names) - allowed)
    if others:
        raise ValueError(
            f"{where}: expected a preset to change lengths, rates, budgets and initial values only, found "
            f"{', '.join(others)}; make it a variant, or a method of its own"
        )
