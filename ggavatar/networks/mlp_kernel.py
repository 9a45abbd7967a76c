"""A perceptron with two hidden ReLU layers, and its gradient, block by block (compiled).

The torch twin is `mlp.perceptron_in_torch`. A block of rows passes through all layers within the cache. The backward
pass skips rows without an upstream gradient, which is exact. Weight gradients are summed within fixed chunks of
rows and then over the chunks in order, so that results do not depend on the number of threads.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Int64
from numpy import ndarray

from ggavatar.jit.kernels import inlined, kernel
from ggavatar.jit.matmul_tiles import add_product
from ggavatar.jit.memory import load, store, stream
from ggavatar.jit.simd import LANES, maximum, select, splat
from ggavatar.jit.threads import run

BLOCK = 64
"""Rows that pass through all layers together."""
CHUNK = 32 * BLOCK
"""Rows per task."""

Floats = Float32[ndarray, "..."]


class Layer(NamedTuple):
    """A layer as flat arrays, padded with zeros to whole SIMD vectors.

    Attributes:
        inputs: Number of inputs without padding.
        outputs: Number of outputs without padding.
        weight: The weight, row-major [outputs, inputs], padded; for the backward pass.
        transposed: The transposed weight [inputs, outputs], padded; for the forward pass.
        bias: The bias, padded.
    """

    inputs: int
    outputs: int
    weight: Floats
    transposed: Floats
    bias: Floats


@kernel
def _linear(x, layer, out):
    """Apply a linear layer to a block."""
    columns = layer.bias.size
    for row in range(BLOCK):
        for column in range(0, columns, LANES):
            store(out, row * columns + column, load(layer.bias, column))
    add_product(x, x.size // BLOCK, 1, BLOCK, layer.inputs, layer.transposed, columns, out)


@kernel
def _rectify(block):
    for at in range(0, block.size, LANES):
        store(block, at, maximum(load(block, at), np.float32(0)))


@kernel
def _clear(block):
    for at in range(0, block.size, LANES):
        store(block, at, splat(np.float32(0)))


@kernel
def _copy(source, first, width, target, at):
    """Copy `width` numbers from `source[first]` to `target[at]`."""
    whole = width // LANES * LANES
    for column in range(0, whole, LANES):
        store(target, at + column, load(source, first + column))
    for column in range(whole, width):
        target[np.uint64(at + column)] = source[np.uint64(first + column)]


@kernel
def _gather_rows(matrix, rows, count, width, block):
    """Copy rows of a matrix into a block; padding and unused slots become zero."""
    columns = block.size // BLOCK
    _clear(block)
    for slot in range(count):
        _copy(matrix, rows[slot] * width, width, block, slot * columns)


@kernel
def _scatter_rows(block, rows, count, width, matrix):
    """Copy rows of a block, without padding, into rows of a matrix."""
    columns = block.size // BLOCK
    for slot in range(count):
        _copy(block, slot * columns, width, matrix, rows[slot] * width)


@kernel
def _stream_rows(block, first, count, width, matrix):
    """Copy rows of a block into consecutive rows of a matrix, bypassing the caches if rows fill whole lines."""
    columns = block.size // BLOCK
    if width == columns:
        for at in range(0, count * width, LANES):
            stream(matrix, first * width + at, load(block, at))
    else:
        _scatter_rows(block, np.arange(first, first + count), count, width, matrix)


@inlined
def _block(layer):
    return np.empty(BLOCK * layer.bias.size, np.float32)


@kernel
def forward_range(features, layers, first, last, kept, result):
    """Write rows `first` … `last` − 1 of the result, and of both hidden layers if `kept` has room for them."""
    one, two, end = layers
    x = np.empty(BLOCK * (one.weight.size // one.bias.size), np.float32)
    hidden_1, hidden_2, out = _block(one), _block(two), _block(end)
    for begin in range(first, last, BLOCK):
        count = min(BLOCK, last - begin)
        rows = np.arange(begin, begin + count)
        _gather_rows(features, rows, count, one.inputs, x)
        _linear(x, one, hidden_1)
        _rectify(hidden_1)
        _linear(hidden_1, two, hidden_2)
        _rectify(hidden_2)
        _linear(hidden_2, end, out)
        if kept[0].size:
            _stream_rows(hidden_1, begin, count, one.outputs, kept[0])
            _stream_rows(hidden_2, begin, count, two.outputs, kept[1])
        _scatter_rows(out, rows, count, end.outputs, result)


class Sums(NamedTuple):
    """Gradients of one chunk by the padded weights (as `Layer.weight`) and biases of the three layers."""

    weight_1: Floats
    bias_1: Floats
    weight_2: Floats
    bias_2: Floats
    weight_3: Floats
    bias_3: Floats


@kernel
def _linear_backward(gradient, layer, inputs, weight_sum, bias_sum, out):
    """Gradients of a linear layer: add those by weight and bias, write those by the inputs to `out`."""
    columns = layer.bias.size
    for column in range(0, columns, LANES):
        value = load(bias_sum, column)
        for row in range(BLOCK):
            value = value + load(gradient, row * columns + column)
        store(bias_sum, column, value)
    wide = out.size // BLOCK
    add_product(gradient, 1, columns, columns, BLOCK, inputs, wide, weight_sum)
    _clear(out)
    add_product(gradient, columns, 1, BLOCK, layer.outputs, layer.weight, wide, out)


@kernel
def _rectifier_backward(gradient, activations):
    """Zero the gradient where the ReLU was inactive."""
    zero = splat(np.float32(0))
    for at in range(0, gradient.size, LANES):
        store(gradient, at, select(load(activations, at) > zero, load(gradient, at), zero))


@kernel
def backward_range(matrices, layers, active, sums, to_features):
    """Add the gradients of one chunk to `sums`: the `active` rows of features, two hidden layers and upstream.

    The gradients with respect to these rows' features are written one after the other to `to_features`.
    """
    one, two, end = layers
    features, kept_1, kept_2, upstream = matrices
    x = np.empty(BLOCK * (one.weight.size // one.bias.size), np.float32)
    hidden_1, hidden_2, out, to_x = _block(one), _block(two), _block(end), np.empty_like(x)
    to_1, to_2 = np.empty_like(hidden_1), np.empty_like(hidden_2)
    for begin in range(0, active.size, BLOCK):
        rows = active[begin : begin + BLOCK]
        count = rows.size
        _gather_rows(upstream, rows, count, end.outputs, out)
        _gather_rows(kept_2, rows, count, two.outputs, hidden_2)
        _gather_rows(kept_1, rows, count, one.outputs, hidden_1)
        _gather_rows(features, rows, count, one.inputs, x)
        _linear_backward(out, end, hidden_2, sums.weight_3, sums.bias_3, to_2)
        _rectifier_backward(to_2, hidden_2)
        _linear_backward(to_2, two, hidden_1, sums.weight_2, sums.bias_2, to_1)
        _rectifier_backward(to_1, hidden_1)
        _linear_backward(to_1, one, x, sums.weight_1, sums.bias_1, to_x)
        _scatter_rows(to_x, np.arange(begin, begin + count), count, one.inputs, to_features)


@kernel
def rows_with_gradient(upstream, width):
    """Indices of the rows that are not all zero."""
    found = np.empty(upstream.size // width, np.int64)
    count = 0
    for row in range(found.size):
        some = False
        for column in range(width):
            some |= upstream[row * width + column] != 0
        found[count] = row
        count += some
    return found[:count]


Layers = tuple[Layer, Layer, Layer]


def forward(features: Floats, layers: Layers, kept: tuple[Floats, Floats], result: Floats) -> None:
    """Write the result of all rows, and both hidden layers if `kept` has room for them; all arrays are flat.

    Arrays in `kept` start on a cache line, as torch's do.
    """
    count = features.size // layers[0].inputs
    starts = range(0, count, CHUNK)

    def task(index: int) -> None:
        forward_range(features, layers, starts[index], min(starts[index] + CHUNK, count), kept, result)

    run(task, len(starts))


class Gradients(NamedTuple):
    """The result of `backward`.

    Attributes:
        rows: Indices of the rows that have a gradient.
        features: Gradients with respect to these rows' features.
        layers: Gradients with respect to every layer's weight and bias.
    """

    rows: Int64[ndarray, " A"]
    features: Floats
    layers: list[tuple[Floats, Floats]]


def backward(matrices: tuple[Floats, Floats, Floats, Floats], layers: Layers) -> Gradients:
    """All gradients, from features, both hidden layers and the upstream gradient (`matrices`, flat)."""
    width = layers[0].inputs
    active = rows_with_gradient(matrices[3], layers[2].outputs)
    to_features = np.empty(len(active) * width, np.float32)
    chunks = [slice(first, min(first + CHUNK, len(active))) for first in range(0, len(active), CHUNK)]
    bounds = _bounds(layers)
    every = np.zeros((len(chunks), bounds[-1].stop), np.float32)
    sums = [Sums(*(row[part] for part in bounds)) for row in every]

    def task(index: int) -> None:
        part = chunks[index]
        to_rows = to_features[part.start * width : part.stop * width]
        backward_range(matrices, layers, active[part], sums[index], to_rows)

    run(task, len(chunks))
    total = every.sum(0)  # row after row
    return Gradients(active, to_features.reshape(-1, width), _unpadded(Sums(*(total[part] for part in bounds)), layers))


def _bounds(layers: Layers) -> list[slice]:
    """Slices of the padded weights and biases of all layers in one concatenated array."""
    ends = np.cumsum([part.size for layer in layers for part in (layer.weight, layer.bias)]).tolist()
    return [slice(first, last) for first, last in zip([0, *ends], ends, strict=False)]


def _unpadded(total: Sums, layers: Layers) -> list[tuple[Floats, Floats]]:
    """Gradients with respect to every layer's weight and bias, without padding."""
    found = []
    for number, layer in enumerate(layers):
        weight = total[2 * number].reshape(layer.bias.size, -1)
        found.append((weight[: layer.outputs, : layer.inputs], total[2 * number + 1][: layer.outputs]))
    return found


def pack(weight: Floats, bias: Floats) -> Layer:
    """A padded layer from weight [outputs, inputs] and bias."""
    outputs, inputs = weight.shape
    padded = np.zeros((_whole(outputs), _whole(inputs)), np.float32)
    padded[:outputs, :inputs] = weight
    padded_bias = np.zeros(_whole(outputs), np.float32)
    padded_bias[:outputs] = bias
    transposed = np.ascontiguousarray(padded[:, :inputs].T)
    return Layer(inputs, outputs, padded.ravel(), transposed.ravel(), padded_bias)


def _whole(width: int) -> int:
    """The next multiple of the number of SIMD lanes."""
    return -(-width // LANES) * LANES
