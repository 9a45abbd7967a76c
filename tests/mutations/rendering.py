"""Planted faults in projection, blending, harmonics and initial colors."""

from __future__ import annotations

from tests.mutations.mutation import Mutation

CLOSED_FORM = "tests/ggavatar/render/test_reference.py::test_one_gaussian_in_closed_form"
CONSTANTS = "tests/ggavatar/render/test_constants.py"
COMPILED = "tests/ggavatar/render/cpu/test_rasterizer.py::test_rendering_and_gradients_equal_float64_autograd"
HARMONICS = "tests/ggavatar/render/test_harmonics.py"
DISCS = "tests/ggavatar/render/discs/test_rasterizer.py"
COLORS = "tests/ggavatar/gaussians/test_initial_colors.py"

MUTATIONS = (
    Mutation(
        "low_pass_a_third",
        "ggavatar/render/constants.py",
        "LOW_PASS = 0.3",
        "LOW_PASS = 0.1",
        (CONSTANTS,),
    ),
    Mutation(
        "alpha_up_to_one",
        "ggavatar/render/constants.py",
        "MAX_ALPHA = 0.99",
        "MAX_ALPHA = 0.999",
        (CONSTANTS,),
    ),
    Mutation(
        "alpha_from_a_hundredth",
        "ggavatar/render/constants.py",
        "MIN_ALPHA = 1 / 255",
        "MIN_ALPHA = 1 / 100",
        (CONSTANTS,),
    ),
    Mutation(
        "pixels_finished_early",
        "ggavatar/render/constants.py",
        "MIN_TRANSMITTANCE = 1e-4",
        "MIN_TRANSMITTANCE = 1e-2",
        (CONSTANTS,),
    ),
    Mutation(
        "near_plane_of_inria",
        "ggavatar/render/constants.py",
        "NEAR = 0.01",
        "NEAR = 0.2",
        (CONSTANTS,),
    ),
    Mutation(
        "view_not_widened",
        "ggavatar/render/constants.py",
        "CLAMP_MARGIN = 0.3",
        "CLAMP_MARGIN = 0.0",
        (CONSTANTS,),
    ),
    Mutation(
        "pixel_centers_at_their_corners",
        "ggavatar/render/reference.py",
        "x = torch.arange(left, right, dtype=like.dtype, device=like.device) + 0.5",
        "x = torch.arange(left, right, dtype=like.dtype, device=like.device)",
        (CLOSED_FORM,),
    ),
    Mutation(
        "drawn_from_back_to_front",
        "ggavatar/render/reference.py",
        "order = torch.argsort(projected.depths, stable=True)",
        "order = torch.argsort(-projected.depths, stable=True)",
        ("tests/ggavatar/render/test_reference.py::test_two_gaussians_are_blended_by_depth_not_by_row",),
    ),
    Mutation(
        "covariance_without_perspective",
        "ggavatar/render/projection.py",
        "rows = (focal_x / z, zero, -focal_x * ratio_x / z,",
        "rows = (focal_x / z, zero, 0 * ratio_x / z,",
        (COMPILED,),
    ),
    Mutation(
        "view_clamped_about_the_middle",
        "ggavatar/render/projection.py",
        "torch.maximum(ratio, -principal / focal - margin), (size - principal) / focal + margin)",
        "torch.maximum(ratio, -size / 2 / focal - margin), size / 2 / focal + margin)",
        (COMPILED,),
    ),
    Mutation(
        "camera_center_mirrored",
        "ggavatar/render/projection.py",
        "return -world_to_camera[:3, :3].T @ world_to_camera[:3, 3]",
        "return world_to_camera[:3, :3].T @ world_to_camera[:3, 3]",
        (COMPILED,),
    ),
    Mutation(
        "harmonics_with_another_sign",
        "ggavatar/render/harmonics.py",
        "values += [-C1 * y, C1 * z, -C1 * x]",
        "values += [C1 * y, C1 * z, C1 * x]",
        (HARMONICS,),
    ),
    Mutation(
        "harmonics_in_another_order",
        "ggavatar/render/harmonics.py",
        "values += [-C1 * y, C1 * z, -C1 * x]",
        "values += [-C1 * x, -C1 * y, C1 * z]",
        (HARMONICS,),
    ),
    Mutation(
        "five_nearest_discs",
        "ggavatar/render/discs/values.py",
        "NEAREST = 10",
        "NEAREST = 5",
        (f"{DISCS}::test_only_the_ten_nearest_discs_show",),
    ),
    Mutation(
        "discs_with_straight_flanks",
        "ggavatar/render/discs/reference.py",
        "alphas = torch.where(nearest, 1 - square, 0)",
        "alphas = torch.where(nearest, 1 - square.sqrt(), 0)",
        (f"{DISCS}::test_one_disc_is_a_paraboloid",),
    ),
    Mutation(
        "background_lends_its_color",
        "ggavatar/gaussians/initial_colors.py",
        "frame.image * frame.alpha, retain_graph=True",
        "frame.image, retain_graph=True",
        (f"{COLORS}::test_background_lends_no_colour",),
    ),
    Mutation(
        "gray_is_the_zero_of_colors",
        "ggavatar/gaussians/initial_colors.py",
        "return (colors - 0.5) / SH_C0",
        "return colors / SH_C0",
        (f"{COLORS}::test_sh_of_a_colour_shows_as_it",),
    ),
)
