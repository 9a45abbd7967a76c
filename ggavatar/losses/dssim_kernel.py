"""Absolute differences, SSIM and their gradient in one pass over stripes of an image (compiled).

The torch twin is `dssim.image_terms_in_torch`.

An image is a matrix of H rows and W·3 floats; horizontal neighbors are 3 floats apart. The rows of a stripe pass
through two ring buffers of 11 lines: blurred inputs, from which a line of similarities and their derivatives follows,
and blurred derivatives, from which a line of the gradient follows. The buffers stay in the second-level cache; only the
gradient is written to memory.
"""

from __future__ import annotations

from math import exp

import numpy as np
from jaxtyping import Float32
from numpy import ndarray

from ggavatar.jit.kernels import inlined, kernel
from ggavatar.jit.threads import run

WINDOW, REACH, SIGMA = 11, 5, 1.5
LUMINANCE, CONTRAST = np.float32(0.01**2), np.float32(0.03**2)
CHANNELS = 3
MARGIN = np.uint64(REACH * CHANNELS)
S1, S2, S3, S4, S5, S6, S7, S8, S9, S10 = (np.uint64(CHANNELS * k) for k in range(1, WINDOW))
STRIPE = 128
"""Rows of a stripe; 20 more are read, so smaller stripes cost more work and larger ones occupy fewer threads."""


def window() -> Float32[ndarray, " K"]:
    """The normalized one-dimensional Gaussian window."""
    weights = np.array([exp(-((index - REACH) ** 2) / (2 * SIGMA**2)) for index in range(WINDOW)])
    return (weights / weights.sum()).astype(np.float32)


@inlined
def _blur_across(padded, out, weights):
    """One line convolved with the symmetric window; `padded` has `MARGIN` zeros at both ends."""
    w0, w1, w2, w3, w4, w5 = weights[0], weights[1], weights[2], weights[3], weights[4], weights[5]
    for i in range(np.uint64(out.size)):
        out[i] = (
            w0 * (padded[i] + padded[i + S10])
            + w1 * (padded[i + S1] + padded[i + S9])
            + w2 * (padded[i + S2] + padded[i + S8])
            + w3 * (padded[i + S3] + padded[i + S7])
            + w4 * (padded[i + S4] + padded[i + S6])
            + w5 * padded[i + S5]
        )


@inlined
def _blur_down(ring, out, weights, first):
    """Weighted sum of the ring's lines, the window starting at line `first`; in two halves, which vectorize."""
    w = np.empty(WINDOW, np.float32)
    for k in range(WINDOW):
        w[(first + k) % WINDOW] = weights[k]
    _sum_of_six(ring[0], ring[1], ring[2], ring[3], ring[4], ring[5], w, out)
    _add_five(ring[6], ring[7], ring[8], ring[9], ring[10], w, out)


@inlined
def _sum_of_six(a, b, c, d, e, f, w, out):
    w0, w1, w2, w3, w4, w5 = w[0], w[1], w[2], w[3], w[4], w[5]
    for i in range(np.uint64(out.size)):
        out[i] = w0 * a[i] + w1 * b[i] + w2 * c[i] + w3 * d[i] + w4 * e[i] + w5 * f[i]


@inlined
def _add_five(a, b, c, d, e, w, out):
    w0, w1, w2, w3, w4 = w[6], w[7], w[8], w[9], w[10]
    for i in range(np.uint64(out.size)):
        out[i] += w0 * a[i] + w1 * b[i] + w2 * c[i] + w3 * d[i] + w4 * e[i]


@inlined
def _products(x, y, padded):
    """x, x² and x·y into the padded lines."""
    for i in range(np.uint64(x.size)):
        padded[0, MARGIN + i] = x[i]
        padded[1, MARGIN + i] = x[i] * x[i]
        padded[2, MARGIN + i] = x[i] * y[i]


@inlined
def _similarity(blurred, mean_y, square_y, factor, sums, derivatives):
    """Add `factor` times a line of SSIM to `sums`; write its derivatives in the local means of x, x² and x·y."""
    one, two = np.float32(1), np.float32(2)
    for i in range(np.uint64(sums.size)):
        mx, my = blurred[0, i], mean_y[i]
        a1 = two * mx * my + LUMINANCE
        a2 = two * (blurred[2, i] - mx * my) + CONTRAST
        inverse_1 = one / (mx * mx + my * my + LUMINANCE)
        inverse_2 = one / (blurred[1, i] - mx * mx + square_y[i] - my * my + CONTRAST)
        inverse = inverse_1 * inverse_2
        value = a1 * a2 * inverse
        sums[i] += factor * value
        derivatives[0, MARGIN + i] = two * (my * (a2 - a1) * inverse + value * mx * (inverse_2 - inverse_1))
        derivatives[1, MARGIN + i] = -value * inverse_2
        derivatives[2, MARGIN + i] = two * a1 * inverse


@inlined
def _differences(x, y, sums):
    """Add a line of |x − y| to `sums`."""
    for i in range(np.uint64(x.size)):
        sums[i] += abs(x[i] - y[i])


@inlined
def _gradient(down, x, y, factors, out):
    """One line of the gradient, from the sign of the difference and the blurred derivatives."""
    two, zero, absolute, similar = np.float32(2), np.float32(0), factors[0], factors[1]
    for i in range(np.uint64(x.size)):
        difference = x[i] - y[i]
        sign = (absolute if difference > zero else zero) - (absolute if difference < zero else zero)
        out[i] = sign + similar * (down[0, i] + two * x[i] * down[1, i] + y[i] * down[2, i])


@kernel
def compare_stripe(x, y, mean_y, square_y, weights, rows, factors, gradient):
    """Sums of |x − y| and of SSIM over the half-open range `rows`.

    If `gradient` has rows, they receive the gradient of the two sums weighted by `factors`.
    """
    (height, width), (first, last) = x.shape, rows
    wanted = gradient.shape[0] > 0
    padded = np.zeros((3, width + 2 * REACH * CHANNELS), np.float32)
    inputs = np.zeros((3, WINDOW, width), np.float32)
    outputs = np.zeros((3, WINDOW, width), np.float32)
    line = np.empty((3, width), np.float32)
    sums, differences = np.zeros(width, np.float32), np.zeros(width, np.float32)
    for row in range(first - 2 * REACH, last + 2 * REACH):
        _take_row(x, y, row, padded, inputs, weights)
        middle = row - REACH
        if row < first or middle >= last + (REACH if wanted else 0):
            continue
        slot = (middle + 2 * WINDOW) % WINDOW
        if middle < 0 or middle >= height:
            outputs[:, slot] = np.float32(0)
        else:
            for k in range(3):
                _blur_down(inputs[k], line[k], weights, (slot + WINDOW - REACH) % WINDOW)
            counted = np.float32(first <= middle < last)
            _similarity(line, mean_y[middle], square_y[middle], counted, sums, padded)
            if first <= middle < last:
                _differences(x[middle], y[middle], differences)
            if wanted:
                for k in range(3):
                    _blur_across(padded[k], outputs[k, slot], weights)
        done = middle - REACH
        if wanted and done >= first:
            for k in range(3):
                _blur_down(outputs[k], line[k], weights, (slot + 1) % WINDOW)
            _gradient(line, x[done], y[done], factors, gradient[done])
    return differences.astype(np.float64).sum(), sums.astype(np.float64).sum()


@kernel
def prepare_stripe(y, weights, first, last, mean, square):
    """Write the local means of `y` and of its square for rows `first` … `last` − 1."""
    width = y.shape[1]
    padded = np.zeros((3, width + 2 * REACH * CHANNELS), np.float32)
    inputs = np.zeros((2, WINDOW, width), np.float32)
    for row in range(first - REACH, last + REACH):
        _take_row(y, y, row, padded, inputs, weights)
        middle = row - REACH
        if middle >= first:
            begin = (middle - REACH + 2 * WINDOW) % WINDOW
            _blur_down(inputs[0], mean[middle], weights, begin)
            _blur_down(inputs[1], square[middle], weights, begin)


@inlined
def _take_row(x, y, row, padded, inputs, weights):
    """Blur a row of x, x² and x·y horizontally into the ring; zeros outside the image."""
    slot = (row + 2 * WINDOW) % WINDOW
    if row < 0 or row >= x.shape[0]:
        inputs[:, slot] = np.float32(0)
        return
    _products(x[row], y[row], padded)
    for k in range(inputs.shape[0]):
        _blur_across(padded[k], inputs[k, slot], weights)


Lines = Float32[ndarray, "_ _"]
"""An image as rows of W·3 floats."""


def compare(
    x: Lines, y: Lines, mean_y: Lines, square_y: Lines, factors: tuple[float, float], gradient: Lines
) -> tuple[float, float]:
    """Sums of |x − y| and of SSIM; `gradient`, unless it has no rows, receives theirs, weighted by `factors`."""
    weights, both = window(), np.array(factors, np.float32)
    stripes = _stripes(x)
    sums = [(0.0, 0.0)] * len(stripes)

    def task(index: int) -> None:
        sums[index] = compare_stripe(x, y, mean_y, square_y, weights, stripes[index], both, gradient)

    run(task, len(sums))
    return sum(part[0] for part in sums), sum(part[1] for part in sums)


def prepare(y: Lines, mean: Lines, square: Lines) -> None:
    """Write the local means of `y` and of its square."""
    weights = window()
    stripes = _stripes(y)
    run(lambda index: prepare_stripe(y, weights, *stripes[index], mean, square), len(stripes))


def _stripes(image: Lines) -> list[tuple[int, int]]:
    """Half-open row ranges of the stripes, independent of the number of threads."""
    height = len(image)
    return [(first, min(first + STRIPE, height)) for first in range(0, height, STRIPE)]
