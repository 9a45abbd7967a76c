"""Absolute differences, SSIM and their gradient in Triton (torch twin: `dssim.image_terms_in_torch`).

Blurs are separable and go through memory: across, then down. Every program takes a block of the image's numbers, three
a pixel; maps are planes of as many numbers. Sums have a fixed order, and upstream gradients stay on the device.
"""

from __future__ import annotations

from math import exp

import torch
import triton.language as tl
from torch import Tensor

from ggavatar.jit import device_kernels
from ggavatar.jit.triton_kernels import device_function, device_kernel

BLOCK = 256
CHANNELS, REACH = tl.constexpr(3), tl.constexpr(5)
LUMINANCE, CONTRAST = tl.constexpr(0.01**2), tl.constexpr(0.03**2)

_WEIGHTS = [exp(-(offset**2) / (2 * 1.5**2)) for offset in range(-5, 6)]
W0, W1, W2, W3, W4, W5 = (tl.constexpr(weight / sum(_WEIGHTS)) for weight in _WEIGHTS[5:])
"""The normalized Gaussian window, from its middle outwards."""


@device_function
def _weight(OFFSET: tl.constexpr):
    """The window at an offset from its middle."""
    if OFFSET == 0:
        value = W0
    elif (OFFSET == 1) | (OFFSET == -1):
        value = W1
    elif (OFFSET == 2) | (OFFSET == -2):
        value = W2
    elif (OFFSET == 3) | (OFFSET == -3):
        value = W3
    elif (OFFSET == 4) | (OFFSET == -4):
        value = W4
    else:
        value = W5
    return value


@device_function
def _block(rows, width, BLOCK: tl.constexpr):
    """Indices of a program's numbers, their rows and columns, and which are in the image."""
    index = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    return index, index // (width * CHANNELS), (index // CHANNELS) % width, index < rows * width * CHANNELS


@device_function
def _down(maps, PLANE: tl.constexpr, index, row, inside, rows, width, BLOCK: tl.constexpr):
    """A plane blurred downwards, with zeros outside the image."""
    line = width * CHANNELS
    total = tl.zeros([BLOCK], tl.float32)
    for step in tl.static_range(2 * REACH + 1):
        there = inside & (row + (step - REACH) >= 0) & (row + (step - REACH) < rows)
        at = maps + PLANE * rows * line + index + (step - REACH) * line
        total += _weight(step - REACH) * tl.load(at, mask=there, other=0.0)
    return total


@device_kernel
def blur_products(x, y, maps, rows, width, BLOCK: tl.constexpr):
    """Write x, x² and x·y, blurred across, to three planes."""
    index, _, column, inside = _block(rows, width, BLOCK)
    first = tl.zeros([BLOCK], tl.float32)
    square, mixed = tl.zeros([BLOCK], tl.float32), tl.zeros([BLOCK], tl.float32)
    for step in tl.static_range(2 * REACH + 1):
        there = inside & (column + (step - REACH) >= 0) & (column + (step - REACH) < width)
        at = index + (step - REACH) * CHANNELS
        a, b = tl.load(x + at, mask=there, other=0.0), tl.load(y + at, mask=there, other=0.0)
        weighted = _weight(step - REACH) * a
        first += weighted
        square += weighted * a
        mixed += weighted * b
    plane = rows * width * CHANNELS
    tl.store(maps + index, first, mask=inside)
    tl.store(maps + plane + index, square, mask=inside)
    tl.store(maps + 2 * plane + index, mixed, mask=inside)


@device_kernel
def blur_means(maps, mean, square_mean, rows, width, BLOCK: tl.constexpr):
    """Write the first two planes, blurred downwards."""
    index, row, _, inside = _block(rows, width, BLOCK)
    tl.store(mean + index, _down(maps, 0, index, row, inside, rows, width, BLOCK), mask=inside)
    tl.store(square_mean + index, _down(maps, 1, index, row, inside, rows, width, BLOCK), mask=inside)


@device_kernel
def compare(x, y, mean_y, square_y, maps, derivatives, sums, rows, width, BLOCK: tl.constexpr):
    """Write SSIM's derivatives in the local means of x, x² and x·y to three planes, and two sums of the block.

    The sums are of |x − y| and of SSIM.
    """
    index, row, _, inside = _block(rows, width, BLOCK)
    mx = _down(maps, 0, index, row, inside, rows, width, BLOCK)
    square = _down(maps, 1, index, row, inside, rows, width, BLOCK)
    mixed = _down(maps, 2, index, row, inside, rows, width, BLOCK)
    my = tl.load(mean_y + index, mask=inside, other=0.0)
    square_of_y = tl.load(square_y + index, mask=inside, other=0.0)
    a1, a2 = 2 * mx * my + LUMINANCE, 2 * (mixed - mx * my) + CONTRAST
    inverse_1 = 1.0 / (mx * mx + my * my + LUMINANCE)
    inverse_2 = 1.0 / (square - mx * mx + square_of_y - my * my + CONTRAST)
    inverse = inverse_1 * inverse_2
    value = a1 * a2 * inverse
    plane = rows * width * CHANNELS
    to_mean = 2 * (my * (a2 - a1) * inverse + value * mx * (inverse_2 - inverse_1))
    tl.store(derivatives + index, to_mean, mask=inside)
    tl.store(derivatives + plane + index, -value * inverse_2, mask=inside)
    tl.store(derivatives + 2 * plane + index, 2 * a1 * inverse, mask=inside)
    difference = tl.abs(tl.load(x + index, mask=inside, other=0.0) - tl.load(y + index, mask=inside, other=0.0))
    tl.store(sums + 2 * tl.program_id(0), tl.sum(difference, axis=0))
    tl.store(sums + 2 * tl.program_id(0) + 1, tl.sum(tl.where(inside, value, 0.0), axis=0))


@device_kernel
def finish_terms(sums, terms, programs, rows, width, l1_weight, dssim_weight, BLOCK: tl.constexpr):
    """Write the two weighted terms, from the sums of `programs` blocks."""
    difference, similarity = tl.zeros([BLOCK], tl.float32), tl.zeros([BLOCK], tl.float32)
    for first in range(0, programs, BLOCK):
        program = first + tl.arange(0, BLOCK)
        difference += tl.load(sums + 2 * program, mask=program < programs, other=0.0)
        similarity += tl.load(sums + 2 * program + 1, mask=program < programs, other=0.0)
    size = (rows * width * CHANNELS).to(tl.float32)
    tl.store(terms, l1_weight * tl.sum(difference, axis=0) / size)
    tl.store(terms + 1, dssim_weight * (1 - tl.sum(similarity, axis=0) / size))


@device_kernel
def blur_derivatives(derivatives, maps, rows, width, BLOCK: tl.constexpr):
    """Write the three planes of derivatives, blurred across."""
    index, _, column, inside = _block(rows, width, BLOCK)
    plane = rows * width * CHANNELS
    for number in tl.static_range(3):
        total = tl.zeros([BLOCK], tl.float32)
        for step in tl.static_range(2 * REACH + 1):
            there = inside & (column + (step - REACH) >= 0) & (column + (step - REACH) < width)
            at = derivatives + number * plane + index + (step - REACH) * CHANNELS
            total += _weight(step - REACH) * tl.load(at, mask=there, other=0.0)
        tl.store(maps + number * plane + index, total, mask=inside)


@device_kernel
def differentiate_terms(x, y, maps, upstream, gradient, rows, width, l1_weight, dssim_weight, BLOCK: tl.constexpr):
    """Write the gradient of x, given those [2] of the two weighted terms."""
    index, row, _, inside = _block(rows, width, BLOCK)
    a, b = tl.load(x + index, mask=inside, other=0.0), tl.load(y + index, mask=inside, other=0.0)
    size = (rows * width * CHANNELS).to(tl.float32)
    absolute, similar = tl.load(upstream) * l1_weight / size, -tl.load(upstream + 1) * dssim_weight / size
    sign = tl.where(a > b, absolute, 0.0) - tl.where(a < b, absolute, 0.0)
    blurred = _down(maps, 0, index, row, inside, rows, width, BLOCK)
    blurred += 2 * a * _down(maps, 1, index, row, inside, rows, width, BLOCK)
    blurred += b * _down(maps, 2, index, row, inside, rows, width, BLOCK)
    tl.store(gradient + index, sign + similar * blurred, mask=inside)


def prepare(y: Tensor) -> tuple[Tensor, Tensor]:
    """The local means of an image [H, W, 3] and of its square."""
    size, programs = y.shape[:2], _programs(y)
    maps, mean, square_mean = y.new_empty(3, *y.shape), torch.empty_like(y), torch.empty_like(y)
    device_kernels.launch(blur_products, programs, y, y, maps, *size, BLOCK=BLOCK)
    device_kernels.launch(blur_means, programs, maps, mean, square_mean, *size, BLOCK=BLOCK)
    return mean, square_mean


def terms_of(x: Tensor, y: Tensor, means: tuple[Tensor, Tensor], weights: tuple[float, float]) -> tuple[Tensor, Tensor]:
    """The two weighted terms [2], and SSIM's derivatives [3, H, W, 3] in local means, for `gradient_of`."""
    size, programs = x.shape[:2], _programs(x)
    maps, derivatives = x.new_empty(3, *x.shape), x.new_empty(3, *x.shape)
    sums, terms = x.new_empty(programs, 2), x.new_empty(2)
    device_kernels.launch(blur_products, programs, x, y, maps, *size, BLOCK=BLOCK)
    device_kernels.launch(compare, programs, x, y, *means, maps, derivatives, sums, *size, BLOCK=BLOCK)
    device_kernels.launch(finish_terms, 1, sums, terms, programs, *size, *weights, BLOCK=256)
    return terms, derivatives


def gradient_of(x: Tensor, y: Tensor, derivatives: Tensor, upstream: Tensor, weights: tuple[float, float]) -> Tensor:
    """The gradient of x, given those [2] of the two terms, which are on the device."""
    size, programs = x.shape[:2], _programs(x)
    maps, gradient = torch.empty_like(derivatives), torch.empty_like(x)
    device_kernels.launch(blur_derivatives, programs, derivatives, maps, *size, BLOCK=BLOCK)
    device_kernels.launch(differentiate_terms, programs, x, y, maps, upstream, gradient, *size, *weights, BLOCK=BLOCK)
    return gradient


def _programs(image: Tensor) -> int:
    return -(-image.numel() // BLOCK)
