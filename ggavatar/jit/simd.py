"""A 16-lane float vector for compiled kernels: LLVM's `<16 x float>` as a numba type.

LLVM maps it to one AVX-512 register, two AVX or four NEON ones. Whether LLVM vectorizes an ordinary loop depends on
heuristics; here vectors are explicit. No operation has fast-math flags, so a formula gives the same bits wherever it is
inlined.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import ConcreteTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model

LANES = 16
_F32, _I16, _I32, _I64 = ir.FloatType(), ir.IntType(16), ir.IntType(32), ir.IntType(64)
_VECTOR, _MASK, _INTS = ir.VectorType(_F32, LANES), ir.VectorType(ir.IntType(1), LANES), ir.VectorType(_I32, LANES)


class _LanesType(types.Type):
    """The numba type of sixteen float32."""


class _FlagsType(types.Type):
    """The numba type of sixteen booleans."""


lanes = _LanesType("lanes16")
flags = _FlagsType("flags16")


@register_model(_LanesType)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager: Any, frontend: Any) -> None:
        super().__init__(manager, frontend, _VECTOR)


@register_model(_FlagsType)
class _FlagsModel(models.PrimitiveModel):
    def __init__(self, manager: Any, frontend: Any) -> None:
        super().__init__(manager, frontend, _MASK)


def constant(value: float | int, scalar: ir.Type = _F32) -> ir.Constant:
    """A vector constant with the same value in every lane."""
    return ir.Constant(ir.VectorType(scalar, LANES), [value] * LANES)


def _splat(builder: ir.IRBuilder, value: ir.Value) -> ir.Value:
    first = builder.insert_element(ir.Constant(_VECTOR, ir.Undefined), value, _I32(0))
    return builder.shuffle_vector(first, ir.Constant(_VECTOR, ir.Undefined), ir.Constant(_INTS, [0] * LANES))


def _as_vector(context: Any, builder: ir.IRBuilder, value: ir.Value, kind: types.Type) -> ir.Value:
    """Convert a number to a vector; vectors stay as they are."""
    if isinstance(kind, _LanesType):
        return value
    return _splat(builder, context.cast(builder, value, kind, types.float32))


def call(builder: ir.IRBuilder, name: str, arguments: list[ir.Value], result: ir.Type | None = None) -> ir.Value:
    """Call an LLVM intrinsic by name."""
    kind = ir.FunctionType(result or arguments[0].type, [argument.type for argument in arguments])
    return builder.call(cgutils.get_or_insert_function(builder.module, kind, name), arguments)


def _binary(function: Any, result: types.Type, build: Callable[[ir.IRBuilder, ir.Value, ir.Value], ir.Value]) -> None:
    """Define a binary operator for two vectors, and for a vector and a number on either side."""
    pairs = [(lanes, lanes), (lanes, types.float32), (types.float32, lanes)]

    class Typing(ConcreteTemplate):
        key = function
        cases = tuple(signature(result, *pair) for pair in pairs)

    infer_global(function)(Typing)
    for pair in pairs:

        def lower(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
            left, right = (
                _as_vector(context, builder, value, kind) for value, kind in zip(args, sig.args, strict=True)
            )
            return build(builder, left, right)

        lower_builtin(function, *pair)(lower)


def _logic(function: Any, build: Callable[[ir.IRBuilder, ir.Value, ir.Value], ir.Value]) -> None:
    """Define a logical operator for vectors of booleans."""

    class Typing(ConcreteTemplate):
        key = function
        cases = (signature(flags, flags, flags),)

    infer_global(function)(Typing)

    def lower(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
        return build(builder, *args)

    lower_builtin(function, flags, flags)(lower)


def _unary(function: Any, build: Callable[[ir.IRBuilder, ir.Value], ir.Value]) -> None:
    """Define a unary operator for vectors."""

    class Typing(ConcreteTemplate):
        key = function
        cases = (signature(lanes, lanes),)

    infer_global(function)(Typing)

    def lower(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
        return build(builder, *args)

    lower_builtin(function, lanes)(lower)


_unary(operator.neg, lambda builder, a: builder.fneg(a))
_binary(operator.add, lanes, lambda builder, a, b: builder.fadd(a, b))
_binary(operator.sub, lanes, lambda builder, a, b: builder.fsub(a, b))
_binary(operator.mul, lanes, lambda builder, a, b: builder.fmul(a, b))
_binary(operator.truediv, lanes, lambda builder, a, b: builder.fdiv(a, b))
_binary(operator.lt, flags, lambda builder, a, b: builder.fcmp_ordered("<", a, b))
_binary(operator.le, flags, lambda builder, a, b: builder.fcmp_ordered("<=", a, b))
_binary(operator.gt, flags, lambda builder, a, b: builder.fcmp_ordered(">", a, b))
_binary(operator.ge, flags, lambda builder, a, b: builder.fcmp_ordered(">=", a, b))
_logic(operator.and_, lambda builder, a, b: builder.and_(a, b))
_logic(operator.or_, lambda builder, a, b: builder.or_(a, b))


def _elementwise(count: int, build: Callable[..., ir.Value]) -> Any:
    """An intrinsic of `count` vectors or numbers that returns a vector."""

    def lower(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
        return build(
            builder, *(_as_vector(context, builder, value, kind) for value, kind in zip(args, sig.args, strict=True))
        )

    if count == 1:
        return intrinsic(lambda typingctx, a: (lanes(a), lower))
    if count == 2:
        return intrinsic(lambda typingctx, a, b: (lanes(a, b), lower))
    return intrinsic(lambda typingctx, a, b, c: (lanes(a, b, c), lower))


def _smaller(builder: ir.IRBuilder, a: ir.Value, b: ir.Value) -> ir.Value:
    return builder.select(builder.fcmp_ordered("<", a, b), a, b)


def _larger(builder: ir.IRBuilder, a: ir.Value, b: ir.Value) -> ir.Value:
    return builder.select(builder.fcmp_ordered(">", a, b), a, b)


# LLVM turns the comparison and select into one minps / maxps; the result is the second operand if one is NaN.
minimum = _elementwise(2, _smaller)
maximum = _elementwise(2, _larger)
fma = _elementwise(3, lambda builder, a, b, c: call(builder, "llvm.fma.v16f32", [a, b, c]))
sqrt = _elementwise(1, lambda builder, a: call(builder, "llvm.sqrt.v16f32", [a]))
absolute = _elementwise(1, lambda builder, a: call(builder, "llvm.fabs.v16f32", [a]))
floor = _elementwise(1, lambda builder, a: call(builder, "llvm.floor.v16f32", [a]))
ceil = _elementwise(1, lambda builder, a: call(builder, "llvm.ceil.v16f32", [a]))
negate = _elementwise(1, lambda builder, a: builder.fneg(a))
splat = _elementwise(1, lambda builder, a: a)


def _exp2(builder: ir.IRBuilder, x: ir.Value) -> ir.Value:
    """2ˣ for x in [-126, 127], relative error 2.6e-6; undefined for other x.

    x = n + f with |f| ≤ ½; a minimax polynomial of 2ᶠ, with n added to its exponent bits.
    """
    magic = constant(12582912.0)  # 1.5 · 2²³; adding it leaves round(x) in the low bits
    shifted = builder.fadd(x, magic)
    fraction = builder.fsub(x, builder.fsub(shifted, magic))
    value = constant(0.0095701)
    for coefficient in (0.05591786, 0.24024745, 0.69312181, 0.99999926):
        value = call(builder, "llvm.fma.v16f32", [value, fraction, constant(coefficient)])
    exponent = builder.shl(builder.bitcast(shifted, _INTS), constant(23, _I32))
    return builder.bitcast(builder.add(builder.bitcast(value, _INTS), exponent), _VECTOR)


def _log2(builder: ir.IRBuilder, x: ir.Value) -> ir.Value:
    """Binary logarithm of normal positive x: the exponent plus the artanh series of the mantissa."""
    bits = builder.bitcast(x, _INTS)
    offset = builder.sub(bits, constant(0x3F3504F3, _I32))  # the bits of √½, so that mantissas are in [√½, √2)
    exponent = builder.ashr(offset, constant(23, _I32))
    mantissa = builder.bitcast(builder.sub(bits, builder.shl(exponent, constant(23, _I32))), _VECTOR)
    ratio = builder.fdiv(builder.fsub(mantissa, constant(1.0)), builder.fadd(mantissa, constant(1.0)))
    square = builder.fmul(ratio, ratio)
    value = constant(2.885390081777927 / 9)
    for order in (7, 5, 3, 1):
        value = call(builder, "llvm.fma.v16f32", [value, square, constant(2.885390081777927 / order)])
    return call(builder, "llvm.fma.v16f32", [value, ratio, builder.sitofp(exponent, _VECTOR)])


def _exp(builder: ir.IRBuilder, x: ir.Value) -> ir.Value:
    """The exponential eˣ, relative error 1.2e-7; x is clamped to [−87, 88.7], and NaN stays NaN.

    x = n ln 2 + r with |r| ≤ ½ ln 2, ln 2 split in two parts, and the Cephes library's polynomial of eʳ.
    """
    clamped = _smaller(builder, _larger(builder, x, constant(-87.0)), constant(88.7))
    magic = constant(12582912.0)  # as in `_exp2`
    shifted = call(builder, "llvm.fma.v16f32", [clamped, constant(1.4426950408889634), magic])
    whole = builder.fneg(builder.fsub(shifted, magic))
    rest = call(builder, "llvm.fma.v16f32", [whole, constant(0.693359375), clamped])
    rest = call(builder, "llvm.fma.v16f32", [whole, constant(-2.12194440e-4), rest])
    value = constant(1.9875691500e-4)
    for coefficient in (1.3981999507e-3, 8.3334519073e-3, 4.1665795894e-2, 1.6666665459e-1, 5.0000001201e-1, 1.0, 1.0):
        value = call(builder, "llvm.fma.v16f32", [value, rest, constant(coefficient)])
    exponent = builder.shl(builder.bitcast(shifted, _INTS), constant(23, _I32))
    found = builder.bitcast(builder.add(builder.bitcast(value, _INTS), exponent), _VECTOR)
    return builder.select(builder.fcmp_unordered("uno", x, x), x, found)


exp = _elementwise(1, _exp)
exp2 = _elementwise(1, _exp2)
log2 = _elementwise(1, _log2)


@intrinsic
def select(typingctx: Any, condition: Any, yes: Any, no: Any) -> Any:
    """Per lane `yes` where the condition holds, else `no`."""

    def lower(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
        yes, no = (
            _as_vector(context, builder, value, kind) for value, kind in zip(args[1:], sig.args[1:], strict=True)
        )
        return builder.select(args[0], yes, no)

    return lanes(condition, yes, no), lower


@intrinsic
def bits_of(typingctx: Any, condition: Any) -> Any:
    """Sixteen booleans as the low bits of an int64."""

    def lower(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
        return builder.zext(builder.bitcast(args[0], _I16), _I64)

    return types.int64(condition), lower


@intrinsic
def total(typingctx: Any, value: Any) -> Any:
    """Sum of the lanes, always in the same order."""

    def lower(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
        value = args[0]
        for step in (8, 4, 2, 1):
            order = [(lane + step) % LANES for lane in range(LANES)]
            value = builder.fadd(value, builder.shuffle_vector(value, value, ir.Constant(_INTS, order)))
        return builder.extract_element(value, _I32(0))

    return types.float32(value), lower


@intrinsic
def lane_indices(typingctx: Any) -> Any:
    """The lane numbers 0, 1, … 15."""

    def lower(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
        return ir.Constant(_VECTOR, [float(lane) for lane in range(LANES)])

    return lanes(), lower


@intrinsic
def lane_index_below(typingctx: Any, count: Any) -> Any:
    """True in the first `count` lanes."""

    def lower(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
        number = builder.sitofp(args[0], _F32)
        return builder.fcmp_ordered(
            "<", ir.Constant(_VECTOR, [float(lane) for lane in range(LANES)]), _splat(builder, number)
        )

    return flags(types.int64), lower
