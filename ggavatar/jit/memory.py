"""Loads, stores, transpositions and bit operations for the 16-lane vectors of `ggavatar.jit.simd`.

Memory is a contiguous array or a pointer; indices count elements and are not checked. Kernels convert their arrays to
pointers first, because passing an array from function to function counts references.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from ggavatar.jit.simd import LANES, call, flags, lanes

_F32, _I8, _I16, _I32, _I64 = ir.FloatType(), ir.IntType(8), ir.IntType(16), ir.IntType(32), ir.IntType(64)
_VECTOR, _INTS = ir.VectorType(_F32, LANES), ir.VectorType(_I32, LANES)


def _address(context: Any, builder: ir.IRBuilder, kind: types.Type, array: ir.Value, index: ir.Value) -> ir.Value:
    """Pointer to an element."""
    data = array if isinstance(kind, types.CPointer) else context.make_array(kind)(context, builder, array).data
    return builder.gep(data, [index])


def _vector_at(builder: ir.IRBuilder, pointer: ir.Value, kind: ir.Type) -> ir.Value:
    return builder.bitcast(pointer, kind.as_pointer())


@intrinsic
def pointer(typingctx: Any, array: Any, index: Any) -> Any:
    """The address of an element; it can be indexed like an array but does not keep the array alive."""

    def lower(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
        return _address(context, builder, sig.args[0], args[0], args[1])

    return types.CPointer(array.dtype)(array, types.int64), lower


@intrinsic
def load(typingctx: Any, array: Any, index: Any) -> Any:
    """Sixteen consecutive elements."""

    def lower(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
        pointer = _address(context, builder, sig.args[0], args[0], args[1])
        return builder.load(_vector_at(builder, pointer, _VECTOR), align=4)

    return lanes(array, types.int64), lower


@intrinsic
def store(typingctx: Any, array: Any, index: Any, value: Any) -> Any:
    """Write sixteen consecutive elements."""

    def lower(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
        pointer = _address(context, builder, sig.args[0], args[0], args[1])
        builder.store(args[2], _vector_at(builder, pointer, _VECTOR), align=4)
        return context.get_dummy_value()

    return types.void(array, types.int64, lanes), lower


@intrinsic
def stream(typingctx: Any, array: Any, index: Any, value: Any) -> Any:
    """As `store`, non-temporal and aligned to a cache line, which saves reading what is overwritten."""

    def lower(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
        pointer = _address(context, builder, sig.args[0], args[0], args[1])
        instruction = builder.store(args[2], _vector_at(builder, pointer, _VECTOR), align=64)
        instruction.set_metadata("nontemporal", builder.module.add_metadata([ir.Constant(_I32, 1)]))
        return context.get_dummy_value()

    return types.void(array, types.int64, lanes), lower


@intrinsic
def store_first_12(typingctx: Any, array: Any, index: Any, value: Any) -> Any:
    """Write the first twelve lanes to consecutive elements."""

    def lower(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
        pointer = _address(context, builder, sig.args[0], args[0], args[1])
        part = builder.shuffle_vector(args[2], args[2], ir.Constant(ir.VectorType(_I32, 12), list(range(12))))
        builder.store(part, _vector_at(builder, pointer, part.type), align=4)
        return context.get_dummy_value()

    return types.void(array, types.int64, lanes), lower


@intrinsic
def gather_rows(typingctx: Any, array: Any, first: Any, last: Any, stride: Any, column: Any) -> Any:
    """One column of sixteen consecutive rows; rows beyond `last` repeat it."""

    def lower(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
        value = ir.Constant(_VECTOR, ir.Undefined)
        for lane, index in enumerate(_row_indices(builder, args[1:])):
            element = builder.load(_address(context, builder, sig.args[0], args[0], index), align=4)
            value = builder.insert_element(value, element, _I32(lane))
        return value

    return lanes(array, *[types.int64] * 4), lower


@intrinsic
def load_flags(typingctx: Any, array: Any, index: Any) -> Any:
    """Sixteen consecutive booleans."""

    def lower(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
        kind = ir.VectorType(_I8, LANES)
        pointer = _address(context, builder, sig.args[0], args[0], args[1])
        return builder.icmp_unsigned("!=", builder.load(_vector_at(builder, pointer, kind), align=1), kind([0] * LANES))

    return flags(array, types.int64), lower


@intrinsic
def gather_flags(typingctx: Any, array: Any, first: Any, last: Any) -> Any:
    """Sixteen consecutive booleans; those beyond `last` are false."""

    def lower(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
        bits = _I16(0)
        for lane, index in enumerate(_row_indices(builder, [args[1], args[2], _I64(1), _I64(0)])):
            held = builder.load(_address(context, builder, sig.args[0], args[0], index))
            there = builder.icmp_signed("<=", builder.add(args[1], _I64(lane)), args[2])
            set_here = builder.and_(builder.icmp_unsigned("!=", held, held.type(0)), there)
            bits = builder.or_(bits, builder.shl(builder.zext(set_here, _I16), _I16(lane)))
        return builder.bitcast(bits, ir.VectorType(ir.IntType(1), LANES))

    return flags(array, types.int64, types.int64), lower


@intrinsic
def scatter_rows(typingctx: Any, array: Any, first: Any, last: Any, stride: Any, column: Any, value: Any) -> Any:
    """Write one column of sixteen consecutive rows; lanes beyond row `last` are dropped."""

    def lower(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
        # In reverse, so that the last row keeps the value of its own lane.
        for lane, index in reversed(list(enumerate(_row_indices(builder, args[1:5])))):
            pointer = _address(context, builder, sig.args[0], args[0], index)
            builder.store(builder.extract_element(args[5], _I32(lane)), pointer, align=4)
        return context.get_dummy_value()

    return types.void(array, *[types.int64] * 4, lanes), lower


def _row_indices(builder: ir.IRBuilder, args: Any) -> list[ir.Value]:
    """Flat indices of `column` in rows first … first + 15, clamped to row `last`."""
    first, last, stride, column = args
    indices = []
    for lane in range(LANES):
        row = builder.add(first, _I64(lane))
        row = builder.select(builder.icmp_signed("<", row, last), row, last)
        indices.append(builder.add(builder.mul(row, stride), column))
    return indices


@intrinsic
def transpose(typingctx: Any, rows: Any) -> Any:
    """Transpose a 16 × 16 matrix of sixteen row vectors."""

    def lower(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
        values = [builder.extract_value(args[0], index) for index in range(LANES)]
        for step in (8, 4, 2, 1):
            values = _swap_halves(builder, values, step)
        result = args[0]
        for index, value in enumerate(values):
            result = builder.insert_value(result, value, index)
        return result

    return rows(rows), lower


def _swap_halves(builder: ir.IRBuilder, values: list[ir.Value], step: int) -> list[ir.Value]:
    """One stage of the butterfly: swaps lanes that have bit `step` set with rows that have it set."""
    low = [lane if not lane & step else LANES + lane - step for lane in range(LANES)]
    high = [lane + step if not lane & step else LANES + lane for lane in range(LANES)]
    swapped = list(values)
    for row in range(LANES):
        if not row & step:
            pair = values[row], values[row + step]
            swapped[row] = builder.shuffle_vector(*pair, ir.Constant(_INTS, low))
            swapped[row + step] = builder.shuffle_vector(*pair, ir.Constant(_INTS, high))
    return swapped


@intrinsic
def column_bits(typingctx: Any, words: Any, column: Any) -> Any:
    """Bit `column` of each of an array's first 64 uint16, as the bits of an int64."""

    def lower(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
        kind = ir.VectorType(_I16, 64)
        pointer = _address(context, builder, sig.args[0], args[0], _I64(0))
        words = builder.load(_vector_at(builder, pointer, kind), align=2)
        bit = builder.shl(_I16(1), builder.trunc(args[1], _I16))
        start = builder.insert_element(ir.Constant(kind, ir.Undefined), bit, _I32(0))
        every = builder.shuffle_vector(start, start, ir.Constant(ir.VectorType(_I32, 64), [0] * 64))
        held = builder.icmp_unsigned("!=", builder.and_(words, every), ir.Constant(kind, [0] * 64))
        return builder.bitcast(held, _I64)

    return types.int64(words, types.int64), lower


@intrinsic
def lowest_bit(typingctx: Any, bits: Any) -> Any:
    """Index of the lowest set bit of a nonzero int64."""

    def lower(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
        return call(builder, "llvm.cttz.i64", [args[0], ir.IntType(1)(1)], _I64)

    return types.int64(types.int64), lower


@intrinsic
def prefetch(typingctx: Any, array: Any, index: Any) -> Any:
    """Prefetch the cache line of an element."""

    def lower(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
        pointer = _address(context, builder, sig.args[0], args[0], args[1])
        address = builder.bitcast(pointer, _I8.as_pointer())
        call(builder, "llvm.prefetch.p0", [address, _I32(0), _I32(3), _I32(1)], ir.VoidType())
        return context.get_dummy_value()

    return types.void(array, types.int64), lower


@intrinsic
def take_ticket(typingctx: Any, counter: Any, index: Any) -> Any:
    """Atomically increment an int64 element; returns its previous value."""

    def lower(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
        pointer = _address(context, builder, sig.args[0], args[0], args[1])
        return builder.atomic_rmw("add", pointer, _I64(1), "monotonic")

    return types.int64(counter, types.int64), lower


@intrinsic
def float_bits(typingctx: Any, value: Any) -> Any:
    """The bits of a float32 as an int64; for positive numbers the order is preserved."""

    def lower(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
        return builder.zext(builder.bitcast(args[0], _I32), _I64)

    return types.int64(types.float32), lower


def _strided(builder: ir.IRBuilder, block: ir.Value, count: int) -> list[ir.Value]:
    """The `count` columns of a block of 16 rows."""
    undefined = ir.Constant(block.type, ir.Undefined)
    picks = ([lane * count + column for lane in range(LANES)] for column in range(count))
    return [builder.shuffle_vector(block, undefined, ir.Constant(_INTS, pick)) for pick in picks]


def _columns(count: int) -> Any:
    """An intrinsic that loads 16 rows of `count` elements as `count` vectors."""

    def lower(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
        kind = ir.VectorType(_F32, LANES * count)
        pointer = _vector_at(builder, _address(context, builder, sig.args[0], args[0], args[1]), kind)
        parts = _strided(builder, builder.load(pointer, align=4), count)
        return context.make_tuple(builder, sig.return_type, parts)

    return intrinsic(lambda typingctx, array, index: (types.UniTuple(lanes, count)(array, types.int64), lower))


load_columns_3 = _columns(3)
load_columns_4 = _columns(4)


def _interleave(builder: ir.IRBuilder, values: list[ir.Value], scalar: ir.Type) -> ir.Value:
    """Interleave the lanes of vectors: a0 b0 c0, a1 b1 c1 and so on."""
    count = len(values)
    width = 1 << (count - 1).bit_length()
    padded = values + [ir.Constant(values[0].type, ir.Undefined)] * (width - count)
    size = LANES
    while len(padded) > 1:
        order = ir.Constant(ir.VectorType(_I32, 2 * size), list(range(2 * size)))
        padded = [builder.shuffle_vector(a, b, order) for a, b in zip(padded[::2], padded[1::2], strict=True)]
        size *= 2
    picks = [column * LANES + lane for lane in range(LANES) for column in range(count)]
    undefined = ir.Constant(padded[0].type, ir.Undefined)
    return builder.shuffle_vector(padded[0], undefined, ir.Constant(ir.VectorType(_I32, LANES * count), picks))


@intrinsic
def store_columns(typingctx: Any, array: Any, index: Any, columns: Any) -> Any:
    """Write vectors as the columns of 16 contiguous rows."""

    def lower(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
        values = [builder.extract_value(args[2], number) for number in range(len(sig.args[2]))]
        block = _interleave(builder, values, _F32)
        pointer = _address(context, builder, sig.args[0], args[0], args[1])
        builder.store(block, _vector_at(builder, pointer, block.type), align=4)
        return context.get_dummy_value()

    return types.void(array, types.int64, columns), lower


@intrinsic
def store_boxes(typingctx: Any, array: Any, index: Any, columns: Any) -> Any:
    """Write four vectors of integers as the int16 columns of 16 contiguous rows."""

    def lower(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
        kind = ir.VectorType(_I16, LANES)
        values = [builder.extract_value(args[2], number) for number in range(4)]
        whole = [builder.trunc(builder.fptosi(value, _INTS), kind) for value in values]
        block = _interleave(builder, whole, _I16)
        pointer = _address(context, builder, sig.args[0], args[0], args[1])
        builder.store(block, _vector_at(builder, pointer, block.type), align=2)
        return context.get_dummy_value()

    return types.void(array, types.int64, columns), lower


@intrinsic
def load_rows(typingctx: Any, array: Any, first: Any, last: Any, stride: Any, column: Any) -> Any:
    """16 elements, from `column` on, of each of the rows first … first + 15; rows beyond `last` repeat it."""

    def lower(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
        values = []
        for index in _row_indices(builder, args[1:]):
            pointer = _address(context, builder, sig.args[0], args[0], index)
            values.append(builder.load(_vector_at(builder, pointer, _VECTOR), align=4))
        return context.make_tuple(builder, sig.return_type, values)

    return types.UniTuple(lanes, LANES)(array, *[types.int64] * 4), lower


def _row_writer(count: int) -> Any:
    """An intrinsic that writes the first `count` lanes of sixteen vectors."""

    def lower(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
        first_lanes = ir.Constant(ir.VectorType(_I32, count), list(range(count)))
        for lane, index in reversed(list(enumerate(_row_indices(builder, args[1:5])))):
            value = builder.extract_value(args[5], lane)
            part = builder.shuffle_vector(value, value, first_lanes)
            pointer = _address(context, builder, sig.args[0], args[0], index)
            builder.store(part, _vector_at(builder, pointer, part.type), align=4)
        return context.get_dummy_value()

    def typed(typingctx: Any, array: Any, first: Any, last: Any, stride: Any, column: Any, rows: Any) -> Any:
        return types.void(array, *[types.int64] * 4, rows), lower

    return intrinsic(typed)


# Both write rows first … first + 15 from `column` on and drop rows beyond `last`.
store_rows, store_rows_10 = _row_writer(LANES), _row_writer(10)


@intrinsic
def stream_rows(typingctx: Any, array: Any, first: Any, last: Any, stride: Any, column: Any, rows: Any) -> Any:
    """As `store_rows`, non-temporal and aligned to cache lines, which saves reading what is overwritten."""

    def lower(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
        nontemporal = builder.module.add_metadata([ir.Constant(_I32, 1)])
        for lane, index in reversed(list(enumerate(_row_indices(builder, args[1:5])))):
            pointer = _address(context, builder, sig.args[0], args[0], index)
            address = _vector_at(builder, pointer, _VECTOR)
            instruction = builder.store(builder.extract_value(args[5], lane), address, align=64)
            instruction.set_metadata("nontemporal", nontemporal)
        return context.get_dummy_value()

    return types.void(array, *[types.int64] * 4, rows), lower


def _blocks(count: int) -> tuple[Any, Any]:
    """Intrinsics that load and store 4 × 4 pixels of `count` interleaved channels as one vector per channel."""

    def row_picks(row: int) -> list[int]:
        return [channel * LANES + row * 4 + x for x in range(4) for channel in range(count)]

    def lower_load(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
        row_kind = ir.VectorType(_F32, 4 * count)
        rows = []
        for number in range(4):
            index = builder.add(args[1], builder.mul(args[2], _I64(number)))
            pointer = _vector_at(builder, _address(context, builder, sig.args[0], args[0], index), row_kind)
            rows.append(builder.load(pointer, align=4))
        pairs = [_concatenate(builder, rows[0], rows[1]), _concatenate(builder, rows[2], rows[3])]
        parts = _strided(builder, _concatenate(builder, *pairs), count)
        return context.make_tuple(builder, sig.return_type, parts)

    def lower_store(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
        values = [builder.extract_value(args[3], number) for number in range(count)]
        values += [ir.Constant(_VECTOR, ir.Undefined)] * (count % 2)
        pairs = [_concatenate(builder, a, b) for a, b in zip(values[::2], values[1::2], strict=True)]
        block = _concatenate(builder, *pairs) if len(pairs) == 2 else pairs[0]
        for number in range(4):
            order = ir.Constant(ir.VectorType(_I32, 4 * count), row_picks(number))
            part = builder.shuffle_vector(block, block, order)
            index = builder.add(args[1], builder.mul(args[2], _I64(number)))
            pointer = _address(context, builder, sig.args[0], args[0], index)
            builder.store(part, _vector_at(builder, pointer, part.type), align=4)
        return context.get_dummy_value()

    def type_load(typingctx: Any, array: Any, index: Any, stride: Any) -> Any:
        return types.UniTuple(lanes, count)(array, types.int64, types.int64), lower_load

    def type_store(typingctx: Any, array: Any, index: Any, stride: Any, block: Any) -> Any:
        return types.void(array, types.int64, types.int64, block), lower_store

    return intrinsic(type_load), intrinsic(type_store)


def _concatenate(builder: ir.IRBuilder, a: ir.Value, b: ir.Value) -> ir.Value:
    """Concatenate the lanes of a and b."""
    order = ir.Constant(ir.VectorType(_I32, 2 * a.type.count), list(range(2 * a.type.count)))
    return builder.shuffle_vector(a, b, order)


load_block_1, store_block_1 = _blocks(1)
load_block_3, store_block_3 = _blocks(3)


@intrinsic
def lane_sums(typingctx: Any, values: Any) -> Any:
    """One vector whose lane k is the sum of the lanes of `values[k]`; lanes without a value are undefined.

    Each of the four stages of the tree folds two vectors into one, so that ten sums cost little more than one.
    """

    def lower(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
        level = [builder.extract_value(args[0], k) for k in range(len(sig.args[0]))]
        for step in (8, 4, 2, 1):
            seconds = [*level[1::2], None][: len(level[::2])]
            level = [_fold(builder, first, second, step) for first, second in zip(level[::2], seconds, strict=True)]
        # The first stage maps the lowest bit of a vector's number to the highest bit of a lane: the order is reversed.
        order = [int(f"{lane:04b}"[::-1], 2) for lane in range(LANES)]
        return builder.shuffle_vector(level[0], level[0], ir.Constant(_INTS, order))

    return lanes(values), lower


def _fold(builder: ir.IRBuilder, first: ir.Value, second: ir.Value | None, step: int) -> ir.Value:
    """Halve the number of partial sums; those of `second` go to the lanes with bit `step` set."""
    low = [lane if not lane & step else LANES + lane - step for lane in range(LANES)]
    high = [lane + step if not lane & step else LANES + lane for lane in range(LANES)]
    other = ir.Constant(_VECTOR, ir.Undefined) if second is None else second
    left = builder.shuffle_vector(first, other, ir.Constant(_INTS, low))
    right = builder.shuffle_vector(first, other, ir.Constant(_INTS, high))
    return builder.fadd(left, right)
