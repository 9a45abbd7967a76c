"""Planted faults in the methods: constants, schedules, terms, and how the parts are wired."""

from __future__ import annotations

from tests.mutations.mutation import Mutation

FOLDER = "ggavatar/methods"
OURS, PLUS = f"{FOLDER}/ggavatar.py", f"{FOLDER}/ggavatar_plus.py"
AVATARS, FLASH = f"{FOLDER}/gaussian_avatars.py", f"{FOLDER}/flash_avatar.py"
BLENDSHAPES, POINTS = f"{FOLDER}/gaussian_blendshapes.py", f"{FOLDER}/point_avatar.py"
SPLATTING, EMBEDDING = f"{FOLDER}/splatting_avatar.py", "ggavatar/gaussians/embedding.py"
PS, SHAPE, SHELL = f"{FOLDER}/ps_avatar.py", "ggavatar/points/morphable_shape.py", "ggavatar/points/shell.py"
WALK, VERTICES = "ggavatar/geometry/triangle_walk.py", "ggavatar/geometry/vertex_frames.py"

TESTS = "tests/ggavatar/methods"
WIRING = f"{TESTS}/test_ggavatar.py"
CONSTANTS = f"{TESTS}/test_published_constants.py"
TORSO = f"{TESTS}/test_torso_and_pose.py::test_the_torso_does_not_turn_with_the_head"
POSE = f"{TESTS}/test_torso_and_pose.py::test_networks_receive_the_face_and_the_pose_in_its_training_range"
PERCEPTUAL = f"{WIRING}::test_perceptual_loss_starts_after_so_many_iterations"
RESET = f"{WIRING}::test_opacities_are_reset_at_500_on_white_only"
RATES = f"{WIRING}::test_rates_and_degrees_follow_the_training"
COLORS = f"{WIRING}::test_short_trainings_start_in_the_colors_of_the_frames"
PAPER = "tests/test_paper.py"
EMBEDDED = "tests/ggavatar/gaussians/test_embedding.py"
WALKED = "tests/ggavatar/geometry/test_triangle_walk.py"
PS_TESTS, SHAPED = f"{TESTS}/test_ps_avatar.py", "tests/ggavatar/points/test_morphable_shape.py"
SHELLS = "tests/ggavatar/points/test_shell.py"

GGAVATAR = (
    Mutation(
        "neutral_phase_a_tenth", OURS, "neutral_iterations: int = 5_000", "neutral_iterations: int = 500", (CONSTANTS,)
    ),
    Mutation(
        "positions_fall_to_a_tenth", OURS, "position_decay: float = 0.01", "position_decay: float = 0.1", (CONSTANTS,)
    ),
    Mutation(
        "scales_learn_as_in_gaussian_avatars",
        OURS,
        "scale_rate: float = 5e-3",
        "scale_rate: float = 0.017",
        (CONSTANTS,),
    ),
    Mutation(
        "opacities_learn_ten_times_faster",
        OURS,
        "opacity_rate: float = 0.05",
        "opacity_rate: float = 0.5",
        (CONSTANTS,),
    ),
    Mutation(
        "networks_learn_ten_times_faster",
        OURS,
        "network_rate: float = 1e-4",
        "network_rate: float = 1e-3",
        (CONSTANTS,),
    ),
    Mutation(
        "tables_learn_ten_times_faster", OURS, "field_rate: float = 5e-3", "field_rate: float = 5e-2", (CONSTANTS,)
    ),
    Mutation("dssim_has_half_the_loss", OURS, "dssim_share: float = 0.2", "dssim_share: float = 0.5", (CONSTANTS,)),
    Mutation(
        "perceptual_weight_ten_times",
        OURS,
        "perceptual_weight: float = 0.02",
        "perceptual_weight: float = 0.2",
        (CONSTANTS,),
    ),
    Mutation(
        "scales_limited_at_six_hundredths",
        OURS,
        "scale_threshold: float = 0.6",
        "scale_threshold: float = 0.06",
        (CONSTANTS,),
    ),
    Mutation(
        "offsets_count_in_decimeters", OURS, "offset_unit: float = 0.01", "offset_unit: float = 0.1", (CONSTANTS,)
    ),
    Mutation(
        "density_control_until_the_end", OURS, "density_stop: int = 60_000", "density_stop: int = 120_000", (CONSTANTS,)
    ),
    Mutation("extent_in_quarter_meters", OURS, "extent: float = 1.0", "extent: float = 4.0", (CONSTANTS,)),
    Mutation(
        "epsilons_of_networks_and_tables_swapped",
        OURS,
        """"lr": config.network_rate, "eps": 1e-8}]
    if tables:
        groups.append({"params": tables, "lr": config.field_rate, "eps": 1e-15})""",
        """"lr": config.network_rate, "eps": 1e-15}]
    if tables:
        groups.append({"params": tables, "lr": config.field_rate, "eps": 1e-8})""",
        (f"{WIRING}::test_rates_and_epsilons_belong_to_their_parameters",),
    ),
    Mutation(
        "tables_learn_with_the_networks",
        OURS,
        'networks = [value for name, value in adjuster.named_parameters() if not name.startswith("field.")]',
        "networks, tables = [value for _, value in adjuster.named_parameters()], []",
        (f"{WIRING}::test_rates_and_epsilons_belong_to_their_parameters",),
    ),
    Mutation(
        "expressions_from_the_first_step",
        OURS,
        "neutral = self.is_neutral or not self.config.skinning",
        "neutral = not self.config.skinning",
        (f"{PAPER}::test_neutral_phase_ignores_the_expression_and_ends_after_5000",),
    ),
    Mutation(
        "adjuster_from_the_first_step",
        OURS,
        "if self.adjuster is not None and not self.is_neutral:",
        "if self.adjuster is not None:",
        (f"{WIRING}::test_adjuster_waits_for_the_end_of_the_neutral_phase",),
    ),
    Mutation(
        "perceptual_loss_from_the_first_step",
        OURS,
        "if config.perceptual_weight and not self.is_neutral:",
        "if config.perceptual_weight:",
        (PERCEPTUAL,),
    ),
    Mutation(
        "coverage_against_the_background",
        OURS,
        "l1(rendering.alpha, frame.alpha)",
        "l1(rendering.alpha, 1 - frame.alpha)",
        (f"{WIRING}::test_coverage_is_compared_with_the_mask",),
    ),
    Mutation(
        "neutral_phase_not_scaled_to_the_training",
        OURS,
        "self.config.neutral_iterations, self.scene.steps\n",
        "self.config.neutral_iterations, 120_000\n",
        (f"{WIRING}::test_neutral_phase_scales_with_the_training",),
    ),
    Mutation(
        "torso_turns_in_ggavatar",
        OURS,
        'if self.config.pose_on == "neck":\n            vertices',
        "if False:\n            vertices",
        (f"{TORSO}[ggavatar]",),
    ),
    Mutation(
        "torso_turns_in_the_neutral_phase",
        OURS,
        'if neutral and self.config.pose_on == "camera":',
        "if neutral:",
        (f"{TESTS}/test_torso_and_pose.py::test_the_torso_is_held_in_the_neutral_phase_too",),
    ),
    Mutation(
        "pose_condition_a_quarter_in_ggavatar",
        OURS,
        "torch.cat((face, self.poses.condition(drive)))",
        "torch.cat((face, self.poses.condition(drive) / 4))",
        (f"{POSE}[ggavatar]",),
    ),
    Mutation(
        "color_rows_in_coefficients",
        OURS,
        "(self.config.color_unit / SH_C0) * offsets.colors",
        "self.config.color_unit * offsets.colors",
        (f"{WIRING}::test_color_rows_count_in_tenths_of_srgb",),
    ),
    Mutation(
        "field_asked_at_posed_positions",
        OURS,
        "return self._bound(self.neutral_local_frames).means",
        "return self._bound(self._local_frames(self.scene.drives[0])).means",
        (f"{WIRING}::test_adjuster_looks_at_neutral_positions",),
    ),
    Mutation(
        "density_control_in_triangle_units",
        OURS,
        "self.density.apply(self.rows, step, self.neutral_local_frames.scales,",
        "self.density.apply(self.rows, step, torch.ones_like(self.neutral_local_frames.scales),",
        (f"{WIRING}::test_density_control_counts_in_meters_and_within_the_budget",),
    ),
    Mutation(
        "density_control_without_the_budget",
        OURS,
        "        budget=scene.max_gaussians,\n",
        "",
        (f"{WIRING}::test_density_control_counts_in_meters_and_within_the_budget",),
    ),
    Mutation(
        "no_statistics_for_density_control",
        OURS,
        "            accumulate(self.rows, rendering)\n",
        "",
        (f"{WIRING}::test_density_control_counts_in_meters_and_within_the_budget",),
    ),
    Mutation(
        "no_reset_at_500_on_white",
        OURS,
        "reset_at_start=bool((scene.background > 0.99).all())",
        "reset_at_start=False",
        (RESET,),
    ),
    Mutation(
        "resets_in_trainings_of_any_length",
        OURS,
        "resetting=scene.steps >= PAPER_STEPS // 10",
        "resetting=True",
        (f"{PAPER}::test_short_trainings_keep_rounds_and_drop_resets",),
    ),
    Mutation(
        "position_rate_never_falls",
        OURS,
        '        self.rows.set_rate("means", position_rate(self.config, self.scene, step))\n',
        "",
        (RATES,),
    ),
    Mutation(
        "short_trainings_start_gray",
        OURS,
        '    if config.first_colors == "frames":\n',
        "    if False:\n",
        (f"{COLORS}[ggavatar]",),
    ),
    Mutation(
        "step_count_stands_still",
        OURS,
        "        self.steps_done.fill_(step)\n",
        "",
        (RATES,),
    ),
    Mutation(
        "regions_weigh_twice",
        PLUS,
        "region_weight: float = 1.0",
        "region_weight: float = 2.0",
        (f"{WIRING}::test_regions_weigh_as_much_again_as_in_the_image_loss",),
    ),
    Mutation(
        "regions_without_the_share_of_l1",
        PLUS,
        "share = 1 - self.avatar.config.dssim_share",
        "share = 1.0",
        (f"{WIRING}::test_regions_weigh_as_much_again_as_in_the_image_loss",),
    ),
    Mutation(
        "regions_from_the_first_step",
        PLUS,
        "if self.config.region_weight and not self.avatar.is_neutral:",
        "if self.config.region_weight:",
        (f"{WIRING}::test_regions_weigh_as_much_again_as_in_the_image_loss",),
    ),
    Mutation(
        "regions_divided_by_their_own_pixels",
        PLUS,
        "return total / (height * width * 3)",
        "return total / max(sum((b[2] - b[0]) * (b[3] - b[1]) * 3 for b in boxes), 1)",
        (f"{TESTS}/test_ggavatar_plus.py::test_regions_are_summed_over_their_boxes_per_pixel_of_the_image",),
    ),
    Mutation(
        "coverage_of_plus_ten_times",
        PLUS,
        "alpha_weight: float = 0.1",
        "alpha_weight: float = 1.0",
        (f"{WIRING}::test_coverage_of_plus_is_a_tenth_of_the_difference",),
    ),
    Mutation(
        "colors_of_plus_half",
        PLUS,
        "color_unit: float = 0.1",
        "color_unit: float = 0.05",
        (f"{WIRING}::test_color_rows_count_in_tenths_of_srgb",),
    ),
    Mutation(
        "torso_of_plus_turns",
        PLUS,
        'pose_on="neck" if config.torso else "camera"',
        'pose_on="camera"',
        (f"{TORSO}[ggavatar_plus]",),
    ),
    Mutation(
        "plus_does_not_see_the_pose",
        PLUS,
        'condition="face_and_pose" if config.pose_condition else "face"',
        'condition="face"',
        (f"{POSE}[ggavatar_plus]",),
    ),
    Mutation(
        "regions_about_the_whole_head",
        "ggavatar/head/region_boxes.py",
        "seen[head.regions[name]].amin(0)",
        "seen.amin(0)",
        (f"{WIRING}::test_regions_are_boxes_of_mouth_and_eyes_in_the_image",),
    ),
)

BASELINES = (
    Mutation(
        "baseline_scales_learn_slowly", AVATARS, "scale_rate: float = 0.017", "scale_rate: float = 5e-3", (CONSTANTS,)
    ),
    Mutation(
        "baseline_expressions_learn_fast",
        AVATARS,
        "expression_rate: float = 1e-3",
        "expression_rate: float = 1e-2",
        (CONSTANTS,),
    ),
    Mutation(
        "baseline_perceptual_loss_from_the_first_step",
        AVATARS,
        "step > config.perceptual_share * self.scene.steps",
        "step > 0",
        (PERCEPTUAL,),
    ),
    Mutation(
        "baseline_without_perceptual_loss",
        AVATARS,
        "perceptual_weight: float = 0.02",
        "perceptual_weight: float = 0.0",
        (CONSTANTS,),
    ),
    Mutation(
        "baseline_not_reset_at_500_on_white",
        AVATARS,
        "reset_at_start=bool((scene.background > 0.99).all())",
        "reset_at_start=False",
        (RESET,),
    ),
    Mutation(
        "baseline_torso_turns",
        AVATARS,
        'if self.config.pose_on == "neck":',
        "if False:",
        (f"{TORSO}[gaussian_avatars]",),
    ),
    Mutation(
        "baseline_corrections_unused",
        AVATARS,
        "return self._local_frames_of(self.corrections(drive))",
        "return self._local_frames_of(drive)",
        (f"{TESTS}/test_gaussian_avatars.py::test_gradients_reach_corrections_of_training_frames_only",),
    ),
    Mutation(
        "baseline_degrees_by_another_length",
        AVATARS,
        "scaled(self.config.sh_iterations, self.scene.steps, self.config.iterations)",
        "scaled(self.config.sh_iterations, self.scene.steps, 600_000)",
        (RATES,),
    ),
    Mutation(
        "baseline_rate_by_another_length",
        AVATARS,
        "last = scaled(config.position_iterations, scene.steps, config.iterations)",
        "last = scaled(config.position_iterations, scene.steps)",
        (f"{TESTS}/test_gaussian_avatars.py::test_own_schedule_is_the_default_and_scales",),
    ),
    Mutation("flash_mouth_weighs_four", FLASH, "mouth_weight: float = 40.0", "mouth_weight: float = 4.0", (CONSTANTS,)),
    Mutation(
        "flash_without_boundary",
        FLASH,
        'boundary: Literal["keep", "drop"] = "keep"',
        'boundary: Literal["keep", "drop"] = "drop"',
        (CONSTANTS,),
    ),
    Mutation(
        "flash_texels_not_those_of_the_comparison", FLASH, '"paper": {"texels": 256}', '"paper": {}', (CONSTANTS,)
    ),
    Mutation(
        "flash_iterations_of_ggavatar", FLASH, "PAPER_ITERATIONS = 150_000", "PAPER_ITERATIONS = 120_000", (PERCEPTUAL,)
    ),
    Mutation(
        "flash_texels_everywhere",
        FLASH,
        "FLAME_COVERAGE = 14_734 / 128**2",
        "FLAME_COVERAGE = 1.0",
        (f"{TESTS}/test_flash_avatar.py::test_number_of_texels_and_the_limit",),
    ),
    Mutation(
        "flash_outputs_not_bounded",
        FLASH,
        "offsets = self.network(self._encoding(), self._condition(drive)).tanh()",
        "offsets = self.network(self._encoding(), self._condition(drive))",
        (f"{TESTS}/test_flash_avatar.py::test_gaussians_are_the_networks_outputs_on_the_mesh",),
    ),
    Mutation(
        "flash_scales_added_to_logarithms",
        FLASH,
        "(log_scales * offsets[:, 7:].exp()).exp()",
        "(log_scales + offsets[:, 7:]).exp()",
        (f"{TESTS}/test_flash_avatar.py::test_moved_follows_the_formulas_row_by_row",),
    ),
    Mutation(
        "flash_encodes_posed_points",
        FLASH,
        "self._samples().points(self.head.neutral(), self.head.faces), self.config.octaves",
        "self._surface_points(self.scene.drives[0]), self.config.octaves",
        (f"{TESTS}/test_flash_avatar.py::test_gaussians_are_the_networks_outputs_on_the_mesh",),
    ),
    Mutation(
        "flash_perceptual_loss_sees_the_background",
        FLASH,
        "self.perceptual(rendering.image * frame.alpha, frame.image * frame.alpha, step, boxes)",
        "self.perceptual(rendering.image, frame.image, step, boxes)",
        (f"{TESTS}/test_flash_avatar.py::test_perceptual_term_begins_late",),
    ),
    Mutation(
        "flash_torso_turns",
        FLASH,
        'if self.config.pose_on == "neck":',
        "if False:",
        (f"{TORSO}[flash_avatar]",),
    ),
    Mutation(
        "flash_pose_condition_zero",
        FLASH,
        "torch.cat((face, self.poses.condition(drive)))",
        "torch.cat((face, 0 * self.poses.condition(drive)))",
        (f"{POSE}[flash_avatar]",),
    ),
    Mutation(
        "flash_starts_gray",
        FLASH,
        '    if config.first_colors == "frames":\n',
        "    if False:\n",
        (f"{COLORS}[flash_avatar]",),
    ),
    Mutation(
        "blendshapes_coverage_a_tenth",
        BLENDSHAPES,
        "alpha_weight: float = 10.0",
        "alpha_weight: float = 1.0",
        (CONSTANTS,),
    ),
    Mutation(
        "blendshapes_differences_ten_times",
        BLENDSHAPES,
        "position_difference_rate: float = 3.2e-7",
        "position_difference_rate: float = 3.2e-6",
        (CONSTANTS,),
    ),
    Mutation(
        "blendshapes_coverage_against_the_background",
        BLENDSHAPES,
        "mse_loss(rendering.alpha, frame.alpha)",
        "mse_loss(rendering.alpha, 1 - frame.alpha)",
        (f"{TESTS}/test_gaussian_blendshapes.py::test_objective_by_hand",),
    ),
    Mutation(
        "blendshapes_differences_everywhere",
        BLENDSHAPES,
        "    if not config.consistency:\n",
        "    if True:\n",
        (f"{TESTS}/test_gaussian_blendshapes.py::test_strengths_follow_the_displacement_of_the_mesh",),
    ),
    Mutation(
        "blendshapes_opacities_reset",
        BLENDSHAPES,
        "resetting=False",
        "resetting=True",
        (f"{TESTS}/test_gaussian_blendshapes.py::test_rates_and_schedule_are_the_authors",),
    ),
    Mutation(
        "blendshapes_torso_turns",
        BLENDSHAPES,
        'if self.config.pose_on == "camera" or not self.poses.in_camera:',
        "if True:",
        (f"{TORSO}[gaussian_blendshapes]",),
    ),
    Mutation(
        "blendshapes_coefficients_without_their_spread",
        BLENDSHAPES,
        "coefficients = torch.cat((drive.expression, drive.eyelids)) / self.spreads",
        "coefficients = torch.cat((drive.expression, drive.eyelids))",
        (f"{TESTS}/test_gaussian_blendshapes.py::test_coefficients_are_counted_in_their_spread",),
    ),
    Mutation(
        "points_in_meters",
        POINTS,
        "UNITS_PER_METER = 4.0",
        "UNITS_PER_METER = 1.0",
        (f"{TESTS}/test_point_avatar.py::test_units_are_those_of_the_authors",),
    ),
    Mutation("points_without_a_limit", POINTS, "max_points: int = 240_000", "max_points: int = 400_000", (CONSTANTS,)),
    Mutation("points_jaw_closed", POINTS, "jaw: float = 0.4", "jaw: float = 0.0", (CONSTANTS,)),
    Mutation(
        "points_coverage_against_the_background",
        POINTS,
        "l1(rendering.alpha, frame.alpha)",
        "l1(rendering.alpha, 1 - frame.alpha)",
        (f"{TESTS}/test_point_avatar.py::test_terms_by_hand",),
    ),
    Mutation(
        "points_head_weight_never_halved",
        POINTS,
        "weight = config.head_weight * 0.5 ** sum(milestone <= self.epoch for milestone in config.head_milestones)",
        "weight = config.head_weight",
        (f"{TESTS}/test_point_avatar.py::test_terms_by_hand",),
    ),
    Mutation(
        "points_perceptual_loss_at_full_size",
        POINTS,
        "return self.perceptual(_resized(rendering.image), _resized(frame.image), step)",
        "return self.perceptual(rendering.image, frame.image, step)",
        (f"{TESTS}/test_point_avatar.py::test_perceptual_loss_compares_images_of_224_px",),
    ),
    Mutation(
        "points_corrected_from_the_start",
        POINTS,
        "self.epoch > self.config.tracking_epochs",
        "self.epoch >= 0",
        (f"{TESTS}/test_point_avatar.py::test_only_training_frames_are_corrected_and_not_at_first",),
    ),
    Mutation(
        "points_translations_corrected_in_their_own_unit",
        POINTS,
        "CorrectionRates(rate, rate, rate / UNITS_PER_METER)",
        "CorrectionRates(rate, rate, rate)",
        (f"{TESTS}/test_point_avatar.py::test_units_are_those_of_the_authors",),
    ),
)

EMBEDDED_METHOD = (
    Mutation(
        "splatting_turns_backward",
        VERTICES,
        "triangle_frames(vertices, faces).rotations @ rest.rotations.transpose(1, 2)",
        "rest.rotations @ triangle_frames(vertices, faces).rotations.transpose(1, 2)",
        ("tests/ggavatar/geometry/test_vertex_frames.py::test_turns_go_forward_not_backward",),
    ),
    Mutation(
        "splatting_turn_on_the_right",
        EMBEDDING,
        "quaternion_multiply(turn, normalize(quats, dim=-1))",
        "quaternion_multiply(normalize(quats, dim=-1), turn)",
        (f"{EMBEDDED}::test_eq_1_to_8_row_by_row",),
    ),
    Mutation(
        "splatting_normals_not_renormalized",
        EMBEDDING,
        "places.distances[:, None] * normalize(normal, dim=-1)",
        "places.distances[:, None] * normal",
        (f"{EMBEDDED}::test_eq_1_to_8_row_by_row",),
    ),
    Mutation(
        "splatting_areas_undamped",
        EMBEDDING,
        "(posed.areas + damping) / (rest.frames.areas + damping)",
        "posed.areas / rest.frames.areas",
        (f"{EMBEDDED}::test_damping_is_added_to_both_areas",),
    ),
    Mutation(
        "splatting_logarithms_in_meters",
        EMBEDDING,
        "AUTHORS_UNITS_PER_METER = 4.0",
        "AUTHORS_UNITS_PER_METER = 1.0",
        (f"{EMBEDDED}::test_the_codes_rule_in_numbers",),
    ),
    Mutation(
        "walk_corners_not_swapped",
        WALK,
        "left[row, there_j], left[row, there_l] = -rest[row, here_l], -rest[row, here_j]",
        "left[row, there_j], left[row, there_l] = -rest[row, here_j], -rest[row, here_l]",
        (f"{WALKED}::test_without_decay_a_walk_on_parallelograms_is_a_straight_line",),
    ),
    Mutation(
        "walk_without_decay",
        WALK,
        "weights[moving], decay * rest)",
        "weights[moving], rest)",
        (f"{WALKED}::test_at_a_crossing_a_tenth_of_the_rest_is_lost",),
    ),
    Mutation(
        "walk_through_edges_of_three",
        WALK,
        "(last - first == 1) & (own == 1)",
        "(last - first >= 1)",
        (f"{WALKED}::test_edges_without_exactly_one_triangle_across_are_walls",),
    ),
    Mutation(
        "splatting_without_lifting",
        SPLATTING,
        'if config.walking == "lifted" else',
        "if False else",
        (f"{TESTS}/test_splatting_avatar.py::test_gradients_reach_slides_only_where_they_are_lifted",),
    ),
    Mutation(
        "splatting_background_fixed",
        SPLATTING,
        "to_device(color, frame.image.device) - self.scene.background",
        "to_device(color, frame.image.device) * 0",
        (f"{TESTS}/test_splatting_avatar.py::test_objective_by_hand",),
    ),
    Mutation(
        "splatting_extent_of_the_configuration",
        SPLATTING,
        "extent: float = 0.5",
        "extent: float = 0.25",
        (CONSTANTS,),
    ),
    Mutation(
        "splatting_torso_turns",
        SPLATTING,
        'if self.config.pose_on == "neck":',
        "if False:",
        (f"{TORSO}[splatting_avatar]",),
    ),
)

POINT_SHAPE = (
    Mutation(
        "ps_points_of_equal_weights",
        SHAPE,
        "(weights[:, :, None] * values.index_select",
        "(torch.full_like(weights, 1 / 3)[:, :, None] * values.index_select",
        (f"{SHAPED}::test_contracting_on_the_mesh_is_blending_every_basis",),
    ),
    Mutation(
        "ps_lids_not_turned_with_the_neck",
        SHAPE,
        "lids @ carrier.T + drive.translation",
        "lids + drive.translation",
        (f"{SHAPED}::test_the_skinned_mesh_is_the_head",),
    ),
    Mutation(
        "ps_points_do_not_turn_with_the_torso",
        SHAPE,
        "turns=torch.lerp(mesh.turns, turned, share)",
        "turns=mesh.turns",
        (f"{SHAPED}::test_turns_are_rotations_and_follow_a_held_torso",),
    ),
    Mutation(
        "ps_corrections_of_still_coefficients",
        SHAPE,
        "self.spread * shape_coefficients(drive)",
        "shape_coefficients(drive)",
        (f"{SHAPED}::test_coefficients_learn_as_much_as_they_move",),
    ),
    Mutation(
        "ps_points_crowd_at_corners",
        SHELL,
        "along = along.sqrt()",
        "along = along * 1",
        (f"{SHELLS}::test_points_on_the_skin_have_the_shares_of_the_areas_and_are_uniform",),
    ),
    Mutation(
        "ps_points_off_the_tongue",
        SHELL,
        "room * ~triangles_of(local, INTERIOR, touching=True)",
        "room * 1",
        (f"{SHELLS}::test_nothing_is_placed_off_the_inside_of_the_mouth",),
    ),
    Mutation(
        "ps_face_as_deep_as_hair",
        SHELL,
        "[off.face].long()",
        "[off.face].long() * 0",
        (f"{SHELLS}::test_offsets_are_uniform_in_the_ranges_of_their_region",),
    ),
    Mutation(
        "ps_points_in_other_skin",
        SHELL,
        ">= CLEARANCE * off.offsets.abs()",
        ">= 0 * off.offsets.abs()",
        (f"{SHELLS}::test_points_off_the_skin_are_clear_of_other_skin",),
    ),
    Mutation(
        "ps_turn_on_the_right",
        PS,
        'quaternion_multiply(turns, normalize(rows["quats"], dim=-1))',
        'quaternion_multiply(normalize(rows["quats"], dim=-1), turns)',
        (f"{PS_TESTS}::test_rotations_are_those_of_the_points_after_their_own",),
    ),
    Mutation(
        "ps_follows_normals_instead_of_skinning",
        PS,
        'if config.follow == "skin":',
        'if config.follow == "normal":',
        (f"{PS_TESTS}::test_off_the_skin_points_follow_skinning_or_the_posed_normal",),
    ),
    Mutation(
        "ps_without_mask_in_the_alignment",
        PS,
        "}, config.mask_weight",
        "}, 0.0",
        (f"{PS_TESTS}::test_objective_of_both_stages_by_hand",),
    ),
    Mutation(
        "ps_round_points_keep_their_size",
        PS,
        'self._size_share(int(self.steps_done)) * rows["log_scales"]',
        '1.0 * rows["log_scales"]',
        (f"{PS_TESTS}::test_round_points_shrink_to_half_and_the_switch_changes_nothing_but_faint_ones",),
    ),
    Mutation(
        "ps_gaussians_start_at_the_first_size",
        PS,
        "new_tensor(self.config.last_size)",
        "new_tensor(self.config.first_size)",
        (f"{PS_TESTS}::test_round_points_shrink_to_half_and_the_switch_changes_nothing_but_faint_ones",),
    ),
    Mutation(
        "ps_prunes_all",
        PS,
        " | (logits >= floor)",
        "",
        (f"{PS_TESTS}::test_pruning_removes_the_faint_but_not_the_last_fifth",),
    ),
    Mutation(
        "ps_harmonics_before_gaussians",
        PS,
        "self.steps_done - self.aligned_after, interval",
        "self.steps_done, interval",
        (f"{PS_TESTS}::test_schedule_scales_with_the_training",),
    ),
    Mutation(
        "ps_alignment_of_half_the_training", PS, "stage_share: float = 0.25", "stage_share: float = 0.5", (CONSTANTS,)
    ),
    Mutation(
        "ps_torso_turns",
        PS,
        'if config.pose_on == "neck" else',
        "if False else",
        (f"{TORSO}[ps_avatar]",),
    ),
)

MUTATIONS = (*GGAVATAR, *BASELINES, *EMBEDDED_METHOD, *POINT_SHAPE)
