"""Planted faults in the trainer, its plan, the optimizers, and the frames that it reads."""

from __future__ import annotations

from tests.mutations.mutation import Mutation

WIRING = "tests/ggavatar/training/test_trainer_wiring.py"
TRAINER, PLAN = "tests/ggavatar/training/test_trainer.py", "tests/ggavatar/training/test_plan.py"
ROWS = "tests/ggavatar/optim/test_parameters.py"
CORRECTIONS = "tests/ggavatar/optim/test_tracking_corrections.py"
SPLITS, FRAMES = "tests/ggavatar/data/test_splits.py", "tests/ggavatar/data/test_frames.py"

MUTATIONS = (
    Mutation(
        "cooling_never_applied",
        "ggavatar/training/trainer.py",
        "step_with_rate_factor(optimizer, self.plan.rate_factor(step))",
        "step_with_rate_factor(optimizer, 1.0)",
        (f"{WIRING}::test_every_optimizer_steps_at_the_plans_factor",),
    ),
    Mutation(
        "coarse_to_fine_never_applied",
        "ggavatar/training/trainer.py",
        "yield number, *self.plan.size_at(step, camera.width, camera.height)",
        "yield number, camera.width, camera.height",
        (f"{WIRING}::test_frames_are_as_large_as_the_plan_says",),
    ),
    Mutation(
        "trained_on_test_frames",
        "ggavatar/training/trainer.py",
        "order = random_order(self.split.train, self.seed, first)",
        "order = random_order(self.split.test, self.seed, first)",
        (f"{WIRING}::test_training_sees_all_training_frames_and_no_other",),
    ),
    Mutation(
        "evaluated_on_training_frames",
        "ggavatar/training/trainer.py",
        "evenly_spaced(self.split.test, self.plan.eval_frames)",
        "evenly_spaced(self.split.train, self.plan.eval_frames)",
        (f"{WIRING}::test_evaluations_come_when_due_on_test_frames_at_full_size",),
    ),
    Mutation(
        "not_evaluated_at_the_end",
        "ggavatar/training/trainer.py",
        "return step == last or (interval > 0 and step % interval == 0)",
        "return interval > 0 and step % interval == 0",
        (f"{WIRING}::test_evaluations_come_when_due_on_test_frames_at_full_size",),
    ),
    Mutation(
        "evaluation_psnr_in_nepers",
        "ggavatar/training/trainer.py",
        "values[str(number)] = float(-10 * torch.log10(error.clamp_min(1e-10)))",
        "values[str(number)] = float(-10 * torch.log(error.clamp_min(1e-10)))",
        (f"{WIRING}::test_evaluations_come_when_due_on_test_frames_at_full_size",),
    ),
    Mutation(
        "gradients_pile_up",
        "ggavatar/training/trainer.py",
        "optimizer.zero_grad(set_to_none=True)",
        "pass",
        (f"{WIRING}::test_gradients_are_of_one_step",),
    ),
    Mutation(
        "method_changes_its_rows_before_the_update",
        "ggavatar/training/trainer.py",
        """            for optimizer in optimizers:
                step_with_rate_factor(optimizer, self.plan.rate_factor(step))
            avatar.after_backward(rendering, step)""",
        """            avatar.after_backward(rendering, step)
            for optimizer in optimizers:
                step_with_rate_factor(optimizer, self.plan.rate_factor(step))""",
        (f"{WIRING}::test_a_step_updates_and_then_lets_the_method_change_its_rows",),
    ),
    Mutation(
        "only_the_first_optimizer_steps",
        "ggavatar/training/trainer.py",
        "            for optimizer in optimizers:\n                step_with",
        "            for optimizer in optimizers[:1]:\n                step_with",
        (f"{WIRING}::test_every_optimizer_steps_at_the_plans_factor",),
    ),
    Mutation(
        "trained_on_black",
        "ggavatar/training/trainer.py",
        "rendering = self.rasterize(avatar.gaussians(frame.drive), frame.camera, self.background)\n        terms",
        "rendering = self.rasterize(avatar.gaussians(frame.drive), frame.camera, 0 * self.background)\n        terms",
        (f"{WIRING}::test_training_renders_on_the_background_of_the_frames",),
    ),
    Mutation(
        "bad_steps_not_skipped",
        "ggavatar/training/trainer.py",
        "if guard.passes(step, terms, avatar):",
        "if guard.passes(step, terms, avatar) or True:",
        (f"{TRAINER}::test_bad_step_changes_nothing",),
    ),
    Mutation(
        "cooled_rates_stay_cool",
        "ggavatar/training/trainer.py",
        '        group["lr"] = rate\n',
        '        group["lr"] = factor * rate\n',
        (f"{PLAN}::test_a_step_at_a_factor_leaves_the_rate_alone",),
    ),
    Mutation(
        "no_cooling_by_default",
        "ggavatar/training/plan.py",
        "cooling: float = 0.4",
        "cooling: float = 0.0",
        (f"{PLAN}::test_default_plan_is_coarse_to_fine_and_cools",),
    ),
    Mutation(
        "cooling_ends_at_a_fifth",
        "ggavatar/training/plan.py",
        "coolest: float = 0.02",
        "coolest: float = 0.2",
        (f"{PLAN}::test_default_plan_is_coarse_to_fine_and_cools",),
    ),
    Mutation(
        "full_size_from_the_first_step",
        "ggavatar/training/plan.py",
        "resolutions: tuple[tuple[float, float], ...] = ((0.25, 0.25), (0.25, 0.5))",
        "resolutions: tuple[tuple[float, float], ...] = ()",
        (f"{PLAN}::test_default_plan_is_coarse_to_fine_and_cools",),
    ),
    Mutation(
        "shares_of_resolutions_do_not_add_up",
        "ggavatar/training/plan.py",
        "passed += share",
        "passed = share",
        (f"{PLAN}::test_coarse_to_fine_in_thirds",),
    ),
    Mutation(
        "paper_preset_cools",
        "ggavatar/training/plan.py",
        "cooling=0.0,",
        "cooling=0.4,",
        (f"{PLAN}::test_paper_preset_is_as_printed",),
    ),
    Mutation(
        "paper_constants_refer_to_half_the_length",
        "ggavatar/optim/schedules.py",
        "PAPER_STEPS = 120_000",
        "PAPER_STEPS = 60_000",
        (f"{PLAN}::test_constants_scale_with_the_length",),
    ),
    Mutation(
        "rates_fall_linearly",
        "ggavatar/optim/schedules.py",
        "return math.exp((1 - progress) * math.log(first) + progress * math.log(last))",
        "return (1 - progress) * first + progress * last",
        (f"{PLAN}::test_position_rate_reaches_a_hundredth_at_half",),
    ),
    Mutation(
        "rows_with_torchs_epsilon",
        "ggavatar/optim/parameters.py",
        "betas=(0.9, 0.999), eps=1e-15, fused=True",
        "betas=(0.9, 0.999), eps=1e-8, fused=True",
        (f"{ROWS}::test_adam_of_rows_is_that_of_3dgs",),
    ),
    Mutation(
        "new_rows_inherit_moments",
        "ggavatar/optim/parameters.py",
        "torch.cat((moments, moments.new_zeros(count, *moments.shape[1:])))",
        "torch.cat((moments, moments[:1].expand(count, *moments.shape[1:])))",
        (ROWS,),
    ),
    Mutation(
        "kept_rows_lose_their_moments",
        "ggavatar/optim/parameters.py",
        "lambda _, values: values[index], lambda moments: moments[index]",
        "lambda _, values: values[index], lambda moments: 0 * moments[index]",
        (ROWS,),
    ),
    Mutation(
        "replaced_column_keeps_its_moments",
        "ggavatar/optim/parameters.py",
        "            moments.zero_()",
        "            moments.mul_(1)",
        (ROWS,),
    ),
    Mutation(
        "corrections_of_expressions_too_fast",
        "ggavatar/optim/tracking_corrections.py",
        "expression: float = 1e-3",
        "expression: float = 1e-2",
        (f"{CORRECTIONS}::test_rates_are_those_of_gaussian_avatars_and_adam_steps_by_them",),
    ),
    Mutation(
        "corrections_with_torchs_epsilon",
        "ggavatar/optim/tracking_corrections.py",
        "eps=1e-15",
        "eps=1e-8",
        (f"{CORRECTIONS}::test_tiny_gradients_move_corrections_as_far_as_large_ones",),
    ),
    Mutation(
        "test_frames_are_corrected",
        "ggavatar/optim/tracking_corrections.py",
        "return drive.frame in self._row",
        "return True",
        (f"{CORRECTIONS}::test_only_training_frames_are_corrected",),
    ),
    Mutation(
        "every_nth_frame_from_the_last_of_n",
        "ggavatar/data/splits.py",
        "test = range(0, count, int(number))",
        "test = range(int(number) - 1, count, int(number))",
        (f"{SPLITS}::test_rules_by_hand",),
    ),
    Mutation(
        "last_frames_one_too_many",
        "ggavatar/data/splits.py",
        "test = range(max(0, count - int(number)), count)",
        "test = range(max(0, count - int(number) - 1), count)",
        (f"{SPLITS}::test_rules_by_hand",),
    ),
    Mutation(
        "test_frames_stay_in_training",
        "ggavatar/data/splits.py",
        "for k in range(count) if k not in tested)",
        "for k in range(count))",
        (f"{SPLITS}::test_disjoint_complete_and_ascending",),
    ),
    Mutation(
        "same_order_every_epoch",
        "ggavatar/data/frames.py",
        "generator=seeded(seed, 1, epoch)",
        "generator=seeded(seed, 1, 0)",
        (f"{FRAMES}::test_order_is_a_permutation_each_epoch_and_can_begin_anywhere",),
    ),
    Mutation(
        "frames_not_composited",
        "ggavatar/data/frames.py",
        "image = self._capture.image(number) * coverage + self.background.numpy() * 255 * (1 - coverage)",
        "image = self._capture.image(number) + self.background.numpy() * 255 * (1 - coverage) * 0",
        (f"{FRAMES}::test_composite_is_straight_alpha_over_the_background",),
    ),
    Mutation(
        "frames_shrunk_by_picking_pixels",
        "ggavatar/data/frames.py",
        "interpolation=cv2.INTER_AREA",
        "interpolation=cv2.INTER_NEAREST",
        (f"{FRAMES}::test_smaller_frames_are_area_means_and_their_cameras_agree",),
    ),
    Mutation(
        "camera_of_a_smaller_image_keeps_its_focal_length",
        "ggavatar/core.py",
        "return Camera(intrinsics, self.world_to_camera, width, height)",
        "return Camera(self.intrinsics, self.world_to_camera, width, height)",
        (f"{FRAMES}::test_smaller_frames_are_area_means_and_their_cameras_agree",),
    ),
    Mutation(
        "tracked_torso_of_the_first_frame_for_all",
        "ggavatar/data/frames.py",
        "torso_pose = None if torso is None else torso[row]",
        "torso_pose = None if torso is None else torso[0]",
        (f"{FRAMES}::test_drives_have_the_torso_of_their_own_frame",),
    ),
    Mutation(
        "methods_know_the_drives_of_test_frames",
        "ggavatar/training/run_folder.py",
        "drives=tuple(reader.drive(number) for number in split.train)",
        "drives=tuple(reader.drive(number) for number in capture.frames)",
        (f"{WIRING}::test_the_scene_of_a_method_holds_training_frames_only",),
    ),
    Mutation(
        "first_colors_from_test_frames",
        "ggavatar/training/run_folder.py",
        "evenly_spaced(split.train, SAMPLE_COUNT)",
        "evenly_spaced(split.test, SAMPLE_COUNT)",
        (f"{WIRING}::test_the_scene_of_a_method_holds_training_frames_only",),
    ),
)
