"""Planted faults in the web avatar: its file, and the page's arithmetic."""

from __future__ import annotations

from tests.mutations.mutation import Mutation

TESTS, PAGE = "tests/ggavatar/formats/web", "ggavatar/formats/web/page"
GAUSSIANS = f"{TESTS}/test_numbers.py::test_gaussians_and_order_are_those_of_torch"

MUTATIONS = (
    Mutation(
        "web_tensors_in_the_order_of_memory",
        "ggavatar/formats/web/container.py",
        "np.ascontiguousarray(tensors[name])",
        "tensors[name]",
        (f"{TESTS}/test_export.py::test_arrays_that_are_not_contiguous_come_back_as_they_were",),
    ),
    Mutation(
        "web_zeros_nearly_zero",
        "ggavatar/formats/web/quantization.py",
        "np.where(np.abs(numbers) < ZERO_WITHIN * step, 0, numbers)",
        "numbers",
        (f"{TESTS}/test_quantization.py::test_zeros_stay_exactly_zero",),
    ),
    Mutation(
        "web_reduction_forgets_the_mean",
        "ggavatar/formats/web/reduction.py",
        "(bias + weight @ mean)",
        "bias",
        (f"{TESTS}/test_reduction.py::test_a_hidden_layer_of_that_rank_loses_nothing",),
    ),
    Mutation(
        "web_visible_weights_summed_over_views",
        "ggavatar/formats/web/pruning.py",
        "torch.maximum(best, weights)",
        "best + weights",
        (f"{TESTS}/test_pruning.py::test_weights_are_sums_of_alpha_times_transmittance",),
    ),
    Mutation(
        "page_lids_turned_backwards",
        f"{PAGE}/head.mjs",
        "carrier[3 * k + axis]",
        "carrier[3 * axis + k]",
        (GAUSSIANS,),
    ),
    Mutation(
        "page_offsets_turn_in_local_axes",
        f"{PAGE}/placement.mjs",
        "product(turn, 0, before, 0, placed, g + 8)",
        "product(before, 0, turn, 0, placed, g + 8)",
        (GAUSSIANS,),
    ),
    Mutation(
        "page_draws_far_to_near",
        f"{PAGE}/depth_sort.mjs",
        "((depths[i] - low) * scale)",
        "((high - depths[i]) * scale)",
        (GAUSSIANS,),
    ),
    Mutation(
        "page_orbits_the_other_way",
        f"{PAGE}/orbit.mjs",
        "rotation(0, this.yaw, 0)",
        "rotation(0, -this.yaw, 0)",
        (f"{TESTS}/test_performance_modules.py::test_the_view_turns_like_our_orbit",),
    ),
    Mutation(
        "page_time_codes_at_thirty",
        f"{PAGE}/curves.mjs",
        "const rate = largest >= 30 ? 60 : 30;",
        "const rate = 30;",
        (f"{TESTS}/test_performance_modules.py::test_recordings_are_read_as_by_our_reader",),
    ),
    Mutation(
        "page_believes_any_shape",
        f"{PAGE}/container.mjs",
        "demand(tensors[name] && String(tensors[name].shape) === String(shape), name);",
        "demand(tensors[name], name);",
        (f"{TESTS}/test_export.py::test_the_page_refuses_damaged_files_in_words",),
    ),
)
