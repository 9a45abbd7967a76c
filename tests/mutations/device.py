"""Planted faults in the kernels for CUDA and in what chooses them; the tests interpret them, which needs Triton."""

from __future__ import annotations

from tests.mutations.mutation import Mutation

BACKENDS = "tests/ggavatar/render/test_backends.py"
TRITON = "tests/ggavatar/render/triton/test_rasterizer.py"
GRADIENTS = f"{TRITON}::test_rendering_and_gradients_equal_float64_autograd"
DISCS = "tests/ggavatar/render/discs/test_device_rasterizer.py"
TRIPLANE = "tests/ggavatar/networks/test_triplane_triton.py"
IMAGES = "tests/ggavatar/losses/test_dssim_triton.py"
BINDING = "tests/ggavatar/gaussians/test_binding_triton.py"
FRAMES = "tests/ggavatar/geometry/test_triangles_triton.py"

MUTATIONS = (
    Mutation(
        "limited_alpha_still_learns_on_cuda",
        "ggavatar/render/triton/tile_gradient.py",
        "raw <= MAX_ALPHA",
        "raw <= 2.0",
        (f"{GRADIENTS}[0-None-0.6]",),
    ),
    Mutation(
        "pixels_never_finish_on_cuda",
        "ggavatar/render/triton/tiles.py",
        "(after >= MIN_TRANSMITTANCE) & ",
        "",
        (f"{GRADIENTS}[0-None-0.6]",),
    ),
    Mutation(
        "camera_center_stays_on_cuda",
        "ggavatar/render/triton/gradient.py",
        "moved = translation[line] * center[column]",
        "moved = 0.0 * center[column]",
        (f"{GRADIENTS}[16-None-0.12]",),
    ),
    Mutation(
        "gradients_of_clamped_colors_on_cuda",
        "ggavatar/render/triton/gradient.py",
        "red = tl.where(tl.load(drawn + RED, mask=seen, other=0.0) > 0, to_color[0], 0.0)",
        "red = tl.where(seen, to_color[0], 0.0)",
        (f"{GRADIENTS}[16-None-0.12]", f"{GRADIENTS}[9-None-0.6]"),
    ),
    Mutation(
        "pairs_without_memory_share_one_place",
        "ggavatar/render/triton/tile_gradient.py",
        "tl.where(overflowed, k, tl.load(places",
        "tl.where(overflowed, 0 * k, tl.load(places",
        (f"{TRITON}::test_too_many_pairs_cost_time_and_no_pixels",),
    ),
    Mutation(
        "faults_on_the_device_are_not_told",
        "ggavatar/render/triton/capacity.py",
        "            if names:\n",
        "            if False:\n",
        (f"{TRITON}::test_nan_and_infinity_are_named_at_a_later_call",),
    ),
    Mutation(
        "gsplat_because_it_imports",
        "ggavatar/render/backends.py",
        '"" if kernels is not None else',
        '"" if importable("gsplat") else',
        (f"{BACKENDS}::test_gsplat_is_chosen_if_its_kernels_are_built_and_not_because_it_imports",),
    ),
    Mutation(
        "discs_move_at_half_speed_on_cuda",
        "ggavatar/render/discs/discs_triton.py",
        "2 * to_cover / radius",
        "to_cover / radius",
        (f"{DISCS}::test_drawing_and_gradients_equal_the_reference_in_float64",),
    ),
    Mutation(
        "another_hash_on_cuda",
        "ggavatar/networks/triplane_triton.py",
        "tl.constexpr(2654435761)",
        "tl.constexpr(805459861)",
        (f"{TRIPLANE}::test_features_and_gradient_equal_the_twin_in_float64",),
    ),
    Mutation(
        "wider_window_of_ssim_on_cuda",
        "ggavatar/losses/dssim_triton.py",
        "(2 * 1.5**2)",
        "(2 * 2.5**2)",
        (f"{IMAGES}::test_terms_and_gradient_equal_the_twin_in_float64",),
    ),
    Mutation(
        "offsets_in_meters_on_cuda",
        "ggavatar/gaussians/offsets_triton.py",
        "alive), unit, _load(",
        "alive), 1.0, _load(",
        (f"{BINDING}::test_geometry_and_gradients_equal_the_twin_in_float64",),
    ),
    Mutation(
        "sizes_of_triangles_by_the_edge_on_cuda",
        "ggavatar/geometry/triangles_triton.py",
        "0.5 * (length + tl.abs(dot(axis_2, edge_20)))",
        "length",
        (f"{FRAMES}::test_frames_equal_the_twin_in_float64",),
    ),
)
