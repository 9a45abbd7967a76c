"""64-bit access to two adjacent floats in compiled kernels, which LLVM does not find by itself."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

_F32, _I32 = ir.FloatType(), ir.IntType(32)
_PAIR = ir.VectorType(_F32, 2)
_UNDEFINED = ir.Constant(_PAIR, ir.Undefined)


def _pointer(context: Any, builder: ir.IRBuilder, kind: types.Array, array: ir.Value, index: ir.Value) -> ir.Value:
    """Address of the pair that starts at flat index `index` of a contiguous array."""
    data = context.make_array(kind)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [index]), _PAIR.as_pointer())


def _splat(builder: ir.IRBuilder, value: ir.Value) -> ir.Value:
    """A pair of the same number twice."""
    first = builder.insert_element(_UNDEFINED, value, _I32(0))
    return builder.shuffle_vector(first, _UNDEFINED, ir.Constant(ir.VectorType(_I32, 2), [0, 0]))


def _multiply_add(builder: ir.IRBuilder, a: ir.Value, b: ir.Value, c: ir.Value) -> ir.Value:
    product = builder.fmul(a, b, flags=("contract",))
    return builder.fadd(product, c, flags=("contract",))


@intrinsic
def blend_pairs(typingctx: Any, source: Any, indices: Any, weights: Any, out: Any, at: Any) -> Any:
    """Write the weighted sum of four pairs of `source`, at flat `indices`, to the pair of `out` at flat index `at`."""

    def lower(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
        total = ir.Constant(_PAIR, [0.0, 0.0])
        for corner in range(4):
            pointer = _pointer(context, builder, sig.args[0], args[0], builder.extract_value(args[1], corner))
            weight = _splat(builder, builder.extract_value(args[2], corner))
            total = _multiply_add(builder, weight, builder.load(pointer, align=4), total)
        builder.store(total, _pointer(context, builder, sig.args[3], args[3], args[4]), align=4)
        return context.get_dummy_value()

    four = types.UniTuple(types.int64, 4), types.UniTuple(types.float32, 4)
    return types.void(source, *four, out, types.int64), lower


@intrinsic
def add_to_pairs(typingctx: Any, target: Any, indices: Any, weights: Any, source: Any, at: Any) -> Any:
    """Add the pair of `source` at flat index `at`, weighted, to four pairs of `target`, one after the other."""

    def lower(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
        value = builder.load(_pointer(context, builder, sig.args[3], args[3], args[4]), align=4)
        for corner in range(4):
            pointer = _pointer(context, builder, sig.args[0], args[0], builder.extract_value(args[1], corner))
            weight = _splat(builder, builder.extract_value(args[2], corner))
            builder.store(_multiply_add(builder, weight, value, builder.load(pointer, align=4)), pointer, align=4)
        return context.get_dummy_value()

    return types.void(
        target, types.UniTuple(types.int64, 4), types.UniTuple(types.float32, 4), source, types.int64
    ), lower
