"""Planted faults in density control."""

from __future__ import annotations

from tests.mutations.mutation import Mutation

FILE = "ggavatar/gaussians/density_control.py"
TEST = "tests/ggavatar/gaussians/test_density_control.py"
THRESHOLDS = f"{TEST}::test_thresholds_are_those_of_3dgs"
METHODS = "tests/ggavatar/methods/test_ggavatar.py"

MUTATIONS = (
    Mutation("grow_scale_ten_times", FILE, "grow_scale: float = 0.01", "grow_scale: float = 0.1", (THRESHOLDS,)),
    Mutation("prune_scale_five_times", FILE, "prune_scale: float = 0.1", "prune_scale: float = 0.5", (THRESHOLDS,)),
    Mutation(
        "prune_opacity_three_times", FILE, "prune_opacity: float = 0.005", "prune_opacity: float = 0.015", (THRESHOLDS,)
    ),
    Mutation("gradient_threshold_halved", FILE, "gradient: float = 2e-4", "gradient: float = 1e-4", (THRESHOLDS,)),
    Mutation(
        "grow_scale_without_the_extent",
        FILE,
        "<= self.grow_scale * self.extent",
        "<= self.grow_scale",
        (f"{TEST}::test_limits_are_relative_to_the_extent",),
    ),
    Mutation(
        "prune_scale_without_the_extent",
        FILE,
        "> self.prune_scale * self.extent",
        "> self.prune_scale",
        (f"{TEST}::test_limits_are_relative_to_the_extent",),
    ),
    Mutation(
        "children_of_a_split_as_large_as_their_parent",
        FILE,
        "SPLIT_SHRINK = 0.8 * SPLIT_CHILDREN",
        "SPLIT_SHRINK = 1.0",
        (f"{TEST}::test_split_replaces_a_row_by_two_smaller_ones_of_its_distribution",),
    ),
    Mutation(
        "children_spread_without_rotation",
        FILE,
        'offset = (quaternion_to_matrix(parents["quats"]) @ (deviation * noise)[..., None]).squeeze(-1)',
        "offset = deviation * noise",
        (f"{TEST}::test_children_spread_as_their_parent_does",),
    ),
    Mutation(
        "children_spread_in_world_units",
        FILE,
        'generator, face_scales if self.split_in == "world" else None)',
        "generator, face_scales)",
        (f"{TEST}::test_children_of_a_split_spread_in_units_of_their_triangle",),
    ),
    Mutation(
        "parents_of_splits_stay",
        FILE,
        "rows.take(torch.cat((~chosen, ~new_rows)).nonzero().squeeze(-1))",
        "rows.take(torch.cat((~(chosen & ~chosen), ~new_rows)).nonzero().squeeze(-1))",
        (f"{TEST}::test_split_replaces_a_row_by_two_smaller_ones_of_its_distribution",),
    ),
    Mutation(
        "faces_lose_their_last_row",
        FILE,
        "return to_prune & (lost < total)[face]",
        "return to_prune",
        (f"{TEST}::test_a_face_keeps_its_last_row",),
    ),
    Mutation(
        "gradients_in_pixels",
        FILE,
        "constant_like((width / 2, height / 2), gradient)",
        "1.0",
        (f"{TEST}::test_statistics_are_ndc_norms_of_visible_rows",),
    ),
    Mutation(
        "hidden_rows_count_as_seen",
        FILE,
        'rows["seen"].add_(visible)',
        'rows["seen"].add_(torch.ones_like(visible))',
        (f"{TEST}::test_statistics_are_ndc_norms_of_visible_rows",),
    ),
    Mutation(
        "gradients_summed_not_averaged",
        FILE,
        'torch.nan_to_num(rows["gradient"] / rows["seen"], nan=0.0, posinf=0.0)',
        'rows["gradient"]',
        (f"{TEST}::test_statistics_are_ndc_norms_of_visible_rows",),
    ),
    Mutation(
        "statistics_never_cleared",
        FILE,
        '        rows["gradient"].zero_()\n',
        "",
        (f"{TEST}::test_round_copies_small_and_splits_large_rows",),
    ),
    Mutation(
        "opacities_reset_to_a_tenth",
        FILE,
        "ceiling: float = 0.01",
        "ceiling: float = 0.1",
        (f"{TEST}::test_reset_is_to_a_hundredth_and_rows_learn_from_zero_moments",),
    ),
    Mutation(
        "opacities_raised_to_the_ceiling",
        FILE,
        ".clamp_max(math.log(ceiling / (1 - ceiling))))",
        ".mul(0).add(math.log(ceiling / (1 - ceiling))))",
        (f"{TEST}::test_reset_is_to_a_hundredth_and_rows_learn_from_zero_moments",),
    ),
    Mutation(
        "no_reset_at_the_start",
        FILE,
        "return step % self.reset_interval == 0 or (self.reset_at_start and step == self.start)",
        "return step % self.reset_interval == 0",
        (f"{METHODS}::test_opacities_are_reset_at_500_on_white_only",),
    ),
    Mutation(
        "reset_in_the_last_step",
        FILE,
        "if not self.resetting or step + self.reset_interval > self.stop:",
        "if not self.resetting or step > self.stop:",
        (f"{TEST}::test_an_opacity_reset_leaves_an_interval_to_recover_in",),
    ),
    Mutation(
        "resets_even_in_short_trainings",
        FILE,
        "if not self.resetting or step + self.reset_interval > self.stop:",
        "if step + self.reset_interval > self.stop:",
        (f"{TEST}::test_schedule_of_rounds_and_resets",),
    ),
    Mutation(
        "rounds_beyond_the_end",
        FILE,
        "return self.start < step < self.stop and step % self.interval == 0",
        "return self.start < step and step % self.interval == 0",
        (f"{TEST}::test_schedule_of_rounds_and_resets",),
    ),
    Mutation(
        "large_rows_pruned_from_the_first_round",
        FILE,
        "if step > self.reset_interval:",
        "if step > 0:",
        (f"{TEST}::test_faint_rows_go_and_large_ones_only_after_the_first_reset_interval",),
    ),
    Mutation(
        "budget_ignored",
        FILE,
        "if int(growing.sum()) > room:",
        "if int(growing.sum()) > 10**9 + room:",
        (f"{TEST}::test_budget_prefers_the_largest_gradients",),
    ),
    Mutation(
        "budget_goes_to_the_smallest_gradients",
        FILE,
        ".argsort(descending=True, stable=True)",
        ".argsort(descending=False, stable=True)",
        (f"{TEST}::test_budget_prefers_the_largest_gradients",),
    ),
    Mutation(
        "budget_all_at_once",
        FILE,
        "room //= max(rounds_left, 1)",
        "room //= 1",
        (f"{TEST}::test_ramp_spreads_the_budget_over_the_rounds",),
    ),
    Mutation(
        "local_sizes_decide",
        FILE,
        '.exp().amax(-1) * face_scales[rows["face"]]',
        ".exp().amax(-1)",
        (f"{TEST}::test_world_size_decides_not_local_size",),
    ),
    Mutation(
        "schedule_of_another_length",
        FILE,
        "first, last = scaled(start, steps, iterations), scaled(stop, steps, iterations)",
        "first, last = scaled(start, steps), scaled(stop, steps)",
        ("tests/ggavatar/methods/test_gaussian_avatars.py::test_own_schedule_is_the_default_and_scales",),
    ),
    Mutation(
        "first_rows_half_transparent",
        "ggavatar/gaussians/initialization.py",
        "torch.full((count,), 0.1).logit(), rates.opacity_logits",
        "torch.full((count,), 0.5).logit(), rates.opacity_logits",
        ("tests/test_paper.py::test_first_rows_are_one_gaussian_per_triangle_at_its_centroid",),
    ),
    Mutation(
        "higher_harmonics_learn_too_fast",
        "ggavatar/gaussians/initialization.py",
        "3), rates.sh / 20)",
        "3), rates.sh)",
        (f"{METHODS}::test_rates_and_epsilons_belong_to_their_parameters",),
    ),
    Mutation(
        "degree_of_harmonics_never_rises",
        "ggavatar/gaussians/spherical_harmonics.py",
        "return min(int(steps_done) // max(interval, 1), highest)",
        "return 0",
        (f"{METHODS}::test_rates_and_degrees_follow_the_training",),
    ),
)
