"""Planted faults in the terms of the objectives."""

from __future__ import annotations

from tests.mutations.mutation import Mutation

DSSIM, TERMS = "tests/ggavatar/losses/test_dssim.py", "tests/ggavatar/losses/test_terms.py"
VGG, VGG_TERM = "tests/ggavatar/losses/test_vgg.py", "tests/ggavatar/losses/test_vgg_term.py"

MUTATIONS = (
    Mutation(
        "dssim_halved_in_the_kernel",
        "ggavatar/losses/dssim.py",
        "image.new_tensor(weights[1] * (1 - similarity / size))",
        "image.new_tensor(weights[1] * (1 - similarity / size) / 2)",
        (f"{DSSIM}::test_interior_equals_scikit_image",),
    ),
    Mutation(
        "dssim_halved_in_torch",
        "ggavatar/losses/dssim.py",
        "return 1 - (luminance * structure).mean()",
        "return (1 - (luminance * structure).mean()) / 2",
        (f"{DSSIM}::test_compiled_value_and_gradient_equal_float64_autograd",),
    ),
    Mutation(
        "dssim_window_wider",
        "ggavatar/losses/dssim.py",
        "WINDOW, SIGMA = 11, 1.5",
        "WINDOW, SIGMA = 11, 2.5",
        (f"{DSSIM}::test_compiled_value_and_gradient_equal_float64_autograd",),
    ),
    Mutation(
        "dssim_constants_swapped",
        "ggavatar/losses/dssim.py",
        "LUMINANCE, CONTRAST = 0.01**2, 0.03**2",
        "LUMINANCE, CONTRAST = 0.03**2, 0.01**2",
        (f"{DSSIM}::test_compiled_value_and_gradient_equal_float64_autograd",),
    ),
    Mutation(
        "l1_keeps_its_full_weight",
        "ggavatar/losses/dssim.py",
        "(1 - dssim_share, dssim_share)",
        "(1.0, dssim_share)",
        ("tests/test_paper.py::test_eq_13_to_16_every_term_with_its_weight",),
    ),
    Mutation(
        "gradient_of_l1_forgets_its_weight",
        "ggavatar/losses/dssim.py",
        "(ctx.weights[0] / image.numel())",
        "(1 / image.numel())",
        (DSSIM,),
    ),
    Mutation(
        "position_regularizer_squared",
        "ggavatar/losses/terms_kernel.py",
        "return select(costs, length - free, zero), factor,",
        "return select(costs, (length - free) * (length - free), zero), factor,",
        (f"{TERMS}::test_eq14_position_costs_beyond_the_threshold_only",),
    ),
    Mutation(
        "regularizers_divided_by_all_rows",
        "ggavatar/losses/terms.py",
        "ctx.count = max(seen, 1)",
        "ctx.count = max(visible.numel(), 1)",
        (f"{TERMS}::test_eq14_position_costs_beyond_the_threshold_only",),
    ),
    Mutation(
        "scale_regularizer_on_logarithms",
        "ggavatar/losses/terms.py",
        "square = (local_log_scales.exp() - threshold)",
        "square = (local_log_scales - threshold)",
        (f"{TERMS}::test_compiled_regularizers_equal_float64_autograd",),
    ),
    Mutation(
        "huber_without_its_delta",
        "ggavatar/losses/terms.py",
        "return huber_loss(image, target, delta=delta)",
        "return huber_loss(image, target)",
        (f"{TERMS}::test_l1_and_huber",),
    ),
    Mutation(
        "vgg_without_imagenet_mean",
        "ggavatar/losses/vgg.py",
        "maps = ((image - mean) / deviation)",
        "maps = (image / deviation)",
        (f"{VGG}::test_equals_a_network_of_torch_layers",),
    ),
    Mutation(
        "vgg_compares_the_ends_of_three_blocks",
        "ggavatar/losses/vgg.py",
        "BLOCKS = ((0, 2), (5, 7), (10, 12, 14), (17, 19, 21))",
        "BLOCKS = ((0, 2), (5, 7), (10, 12, 14))",
        (f"{VGG}::test_equals_a_network_of_torch_layers",),
    ),
    Mutation(
        "vgg_compares_before_the_last_convolution_of_a_block",
        "ggavatar/losses/vgg.py",
        "BLOCKS = ((0, 2), (5, 7), (10, 12, 14), (17, 19, 21))",
        "BLOCKS = ((0, 2), (5, 7), (10, 12), (17, 19, 21))",
        (f"{VGG}::test_equals_a_network_of_torch_layers",),
    ),
    Mutation(
        "vgg_differences_squared",
        "ggavatar/losses/vgg.py",
        "[(ours - theirs).abs().mean() for",
        "[(ours - theirs).square().mean() for",
        (f"{VGG}::test_equals_a_network_of_torch_layers",),
    ),
    Mutation(
        "crops_weigh_less_than_images",
        "ggavatar/losses/vgg_term.py",
        "window, weight = drawn, weight / self.crops.probability",
        "window = drawn",
        (f"{VGG_TERM}::test_crops_have_the_same_expected_weight_and_repeat_themselves",),
    ),
    Mutation(
        "crops_never_centered_on_mouth_and_eyes",
        "ggavatar/losses/crop_sampler.py",
        "focused: float = 0.5",
        "focused: float = 0.0",
        (f"{VGG}::test_half_of_the_crops_are_centered_on_boxes",),
    ),
    Mutation(
        "crops_of_the_same_place_in_every_step",
        "ggavatar/losses/vgg_term.py",
        "seeded(self.seed, self.stream, step)",
        "seeded(self.seed, self.stream)",
        (f"{VGG_TERM}::test_crops_have_the_same_expected_weight_and_repeat_themselves",),
    ),
)
