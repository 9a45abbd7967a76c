"""A network of two rectified layers and a linear end, and its gradient, block by block (twin: `perceptron.in_torch`).

A block of rows goes through all layers within the cache. Rows without an upstream gradient are left out of the backward
pass, which is exact. Gradients of the weights are summed within fixed chunks of rows and then over the chunks in order:
the same bits for any number of threads.
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
"""Rows that go through all layers together."""
CHUNK = 32 * BLOCK
"""Rows of a task."""

Floats = Float32[ndarray, "..."]


class Layer(NamedTuple):
    """One layer, flat, its widths padded with zeros to whole vectors.

    Attributes:
        inputs: Columns without padding.
        outputs: Rows without padding.
        weight: Row-major, padded inputs as columns; for the way back.
        turned: The transposed, padded outputs as columns; for the way forth.
        bias: One number an output.
    """

    inputs: int
    outputs: int
    weight: Floats
    turned: Floats
    bias: Floats


@kernel
def _apply(x, layer, out):
    """A block through a linear layer."""
    columns = layer.bias.size
    for row in range(BLOCK):
        for column in range(0, columns, LANES):
            store(out, row * columns + column, load(layer.bias, column))
    add_product(x, x.size // BLOCK, 1, BLOCK, layer.inputs, layer.turned, columns, out)


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
    """`width` numbers from `first` on to `at`."""
    whole = width // LANES * LANES
    for column in range(0, whole, LANES):
        store(target, at + column, load(source, first + column))
    for column in range(whole, width):
        target[np.uint64(at + column)] = source[np.uint64(first + column)]


@kernel
def _take(matrix, rows, count, width, block):
    """Rows of a matrix into a block; the padding and the slots that are left over become zero."""
    columns = block.size // BLOCK
    _clear(block)
    for slot in range(count):
        _copy(matrix, rows[slot] * width, width, block, slot * columns)


@kernel
def _put(block, rows, count, width, matrix):
    """Rows of a block into a matrix, without padding."""
    columns = block.size // BLOCK
    for slot in range(count):
        _copy(block, slot * columns, width, matrix, rows[slot] * width)


@kernel
def _keep(block, first, count, width, matrix):
    """Rows of a block into consecutive rows of a matrix that nobody reads soon, past the caches if they fill lines."""
    columns = block.size // BLOCK
    if width == columns:
        for at in range(0, count * width, LANES):
            stream(matrix, first * width + at, load(block, at))
    else:
        _put(block, np.arange(first, first + count), count, width, matrix)


@inlined
def _block(layer):
    return np.empty(BLOCK * layer.bias.size, np.float32)


@kernel
def forward_range(features, layers, first, last, kept, result):
    """Rows `first` … `last` − 1 of the result; the two hidden layers are kept if there is room for them."""
    one, two, end = layers
    x = np.empty(BLOCK * (one.weight.size // one.bias.size), np.float32)
    hidden_1, hidden_2, out = _block(one), _block(two), _block(end)
    for begin in range(first, last, BLOCK):
        count = min(BLOCK, last - begin)
        rows = np.arange(begin, begin + count)
        _take(features, rows, count, one.inputs, x)
        _apply(x, one, hidden_1)
        _rectify(hidden_1)
        _apply(hidden_1, two, hidden_2)
        _rectify(hidden_2)
        _apply(hidden_2, end, out)
        if kept[0].size:
            _keep(hidden_1, begin, count, one.outputs, kept[0])
            _keep(hidden_2, begin, count, two.outputs, kept[1])
        _put(out, rows, count, end.outputs, result)


class Sums(NamedTuple):
    """Gradients of one chunk: of the padded weights (as `Layer.weight`) and biases of the three layers."""

    weight_1: Floats
    bias_1: Floats
    weight_2: Floats
    bias_2: Floats
    weight_3: Floats
    bias_3: Floats


@kernel
def _back(gradient, layer, inputs, weight_sum, bias_sum, out):
    """A block's gradient through a linear layer: to its weights, its bias and its inputs."""
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
def _close(gradient, activations):
    """No gradient where the rectifier was closed."""
    zero = splat(np.float32(0))
    for at in range(0, gradient.size, LANES):
        store(gradient, at, select(load(activations, at) > zero, load(gradient, at), zero))


@kernel
def backward_range(matrices, layers, active, sums, to_features):
    """Gradients of one chunk: `active` rows of `matrices` (features, two hidden layers, upstream) into `sums`.

    The gradients of these rows' features are written one after the other to `to_features`.
    """
    one, two, end = layers
    features, kept_1, kept_2, upstream = matrices
    x = np.empty(BLOCK * (one.weight.size // one.bias.size), np.float32)
    hidden_1, hidden_2, out, to_x = _block(one), _block(two), _block(end), np.empty_like(x)
    to_1, to_2 = np.empty_like(hidden_1), np.empty_like(hidden_2)
    for begin in range(0, active.size, BLOCK):
        rows = active[begin : begin + BLOCK]
        count = rows.size
        _take(upstream, rows, count, end.outputs, out)
        _take(kept_2, rows, count, two.outputs, hidden_2)
        _take(kept_1, rows, count, one.outputs, hidden_1)
        _take(features, rows, count, one.inputs, x)
        _back(out, end, hidden_2, sums.weight_3, sums.bias_3, to_2)
        _close(to_2, hidden_2)
        _back(to_2, two, hidden_1, sums.weight_2, sums.bias_2, to_1)
        _close(to_1, hidden_1)
        _back(to_1, one, x, sums.weight_1, sums.bias_1, to_x)
        _put(to_x, np.arange(begin, begin + count), count, one.inputs, to_features)


@kernel
def rows_with_gradient(upstream, width):
    """Numbers of the rows that are not all zero."""
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
    """Fill in the result of all rows, and both hidden layers if `kept` has room for them; all flat.

    Memory in `kept` begins on a cache line, as torch's does.
    """
    count = features.size // layers[0].inputs
    starts = range(0, count, CHUNK)

    def task(index: int) -> None:
        forward_range(features, layers, starts[index], min(starts[index] + CHUNK, count), kept, result)

    run(task, len(starts))


class Gradients(NamedTuple):
    """What `backward` finds.

    Attributes:
        rows: Numbers of the rows that have a gradient.
        features: Gradient of these rows' features.
        layers: Gradients of every layer's weight and bias.
    """

    rows: Int64[ndarray, " A"]
    features: Floats
    layers: list[tuple[Floats, Floats]]


def backward(matrices: tuple[Floats, Floats, Floats, Floats], layers: Layers) -> Gradients:
    """Gradients of everything, from the features, both hidden layers and the upstream gradient, all flat."""
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
    """Where the padded weights and biases of all layers lie when they follow one another."""
    ends = np.cumsum([part.size for layer in layers for part in (layer.weight, layer.bias)]).tolist()
    return [slice(first, last) for first, last in zip([0, *ends], ends, strict=False)]


def _unpadded(total: Sums, layers: Layers) -> list[tuple[Floats, Floats]]:
    """The gradient of every layer's weight and bias, without padding."""
    found = []
    for number, layer in enumerate(layers):
        weight = total[2 * number].reshape(layer.bias.size, -1)
        found.append((weight[: layer.outputs, : layer.inputs], total[2 * number + 1][: layer.outputs]))
    return found


def pack(weight: Floats, bias: Floats) -> Layer:
    """A layer with its widths padded."""
    outputs, inputs = weight.shape
    padded = np.zeros((_whole(outputs), _whole(inputs)), np.float32)
    padded[:outputs, :inputs] = weight
    padded_bias = np.zeros(_whole(outputs), np.float32)
    padded_bias[:outputs] = bias
    turned = np.ascontiguousarray(padded[:, :inputs].T)
    return Layer(inputs, outputs, padded.ravel(), turned.ravel(), padded_bias)


def _whole(width: int) -> int:
    """The next multiple of the vector's lanes."""
    return -(-width // LANES) * LANES
