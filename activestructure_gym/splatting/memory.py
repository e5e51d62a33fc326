"""Access arrays from kernels: vectors of 16 floats, single elements and bits.

Also transpose vectors and sum their lanes. Arrays are C-ordered, and ``index`` is the index of an element in the flat
array.
"""

# mypy: ignore-errors
# (the arguments of kernels have numba's types, and intrinsics are called without their typing context)

from __future__ import annotations

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from activestructure_gym.splatting.simd import BIT, F32, FLOATS, I32, I64, INTS, LANES, allocating, floats


def pointer_to(context, builder, array_type, array, index):
    """Return the LLVM pointer to an element of a C-ordered array, given its flat index."""
    data = context.make_array(array_type)(context, builder, value=array).data
    return builder.gep(data, [index], inbounds=True)


@intrinsic
def load(typingctx, array, index):
    """Load the 16 floats from ``index`` on of a float32 array."""

    def codegen(context, builder, sig, args):
        pointer = pointer_to(context, builder, sig.args[0], args[0], args[1])
        return builder.load(builder.bitcast(pointer, FLOATS.as_pointer()), align=4, typ=FLOATS)

    return floats(array, types.intp), codegen


@intrinsic
def store(typingctx, array, index, value):
    """Store 16 floats from ``index`` on in a float32 array."""

    def codegen(context, builder, sig, args):
        pointer = pointer_to(context, builder, sig.args[0], args[0], args[1])
        builder.store(args[2], builder.bitcast(pointer, FLOATS.as_pointer()), align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, floats), codegen


@intrinsic
def peek(typingctx, array, index):
    """Load one element, without numba's test for negative indices."""

    def codegen(context, builder, sig, args):
        return builder.load(pointer_to(context, builder, sig.args[0], args[0], args[1]))

    return array.dtype(array, types.intp), codegen


@intrinsic
def poke(typingctx, array, index, value):
    """Store one element, without numba's test for negative indices."""

    def codegen(context, builder, sig, args):
        builder.store(args[2], pointer_to(context, builder, sig.args[0], args[0], args[1]))
        return context.get_dummy_value()

    return types.void(array, types.intp, array.dtype), codegen


@intrinsic
def poke_add(typingctx, array, index, value):
    """Add ``value`` to one element of an array of integers."""

    def codegen(context, builder, sig, args):
        pointer = pointer_to(context, builder, sig.args[0], args[0], args[1])
        builder.store(builder.add(builder.load(pointer), args[2]), pointer)
        return context.get_dummy_value()

    return types.void(array, types.intp, array.dtype), codegen


@intrinsic
def peek_bits(typingctx, array, index):
    """Return the bits of one float32 as an int64, with zeros above bit 31."""

    def codegen(context, builder, sig, args):
        pointer = pointer_to(context, builder, sig.args[0], args[0], args[1])
        return builder.zext(builder.load(builder.bitcast(pointer, I32.as_pointer()), typ=I32), I64)

    return types.int64(array, types.intp), codegen


@intrinsic
def poke_bits(typingctx, array, index, value):
    """Store the low 32 bits of an integer as one element of a float32 array."""

    def codegen(context, builder, sig, args):
        pointer = pointer_to(context, builder, sig.args[0], args[0], args[1])
        builder.store(builder.trunc(args[2], I32), builder.bitcast(pointer, I32.as_pointer()))
        return context.get_dummy_value()

    return types.void(array, types.intp, types.int64), codegen


@intrinsic
def prefetch(typingctx, array, index):
    """Prefetch the cache line of an element for reading."""

    def codegen(context, builder, sig, args):
        pointer = pointer_to(context, builder, sig.args[0], args[0], args[1])
        pointer = builder.bitcast(pointer, ir.IntType(8).as_pointer())
        kind = ir.FunctionType(ir.VoidType(), [pointer.type, I32, I32, I32])
        function = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0")
        builder.call(function, [pointer, ir.Constant(I32, 0), ir.Constant(I32, 3), ir.Constant(I32, 1)])
        return context.get_dummy_value()

    return types.void(array, types.intp), codegen


@intrinsic
def _to_line(typingctx, array):
    """Return the number of floats between the start of an array and the next 64-byte boundary."""

    def codegen(context, builder, sig, args):
        data = context.make_array(sig.args[0])(context, builder, value=args[0]).data
        address = builder.ptrtoint(data, I64)
        return builder.and_(builder.lshr(builder.neg(address), ir.Constant(I64, 2)), ir.Constant(I64, 15))

    return types.int64(array), codegen


@allocating
def scratch_of(size):
    """Return an uninitialised float32 array that starts on a cache line, since vectors across two lines cost double."""
    room = np.empty(size + LANES, np.float32)
    start = _to_line(room)
    return room[start : start + size]


@intrinsic
def lowest_bit(typingctx, value):
    """Return the index of the lowest set bit of an integer that is not 0."""

    def codegen(context, builder, sig, args):
        return builder.cttz(args[0], ir.Constant(BIT, 1))

    return types.int64(types.int64), codegen


@intrinsic
def count_bits(typingctx, value):
    """Return the number of set bits of an integer."""

    def codegen(context, builder, sig, args):
        return builder.ctpop(args[0])

    return types.int64(types.uint64), codegen


def _transposed(builder, rows):
    """Return 16 vectors transposed, by four rounds of exchanges between pairs of vectors."""
    for step in (1, 2, 4, 8):
        first = [lane if not lane & step else LANES + lane - step for lane in range(LANES)]
        second = [lane + step if not lane & step else LANES + lane for lane in range(LANES)]
        result = list(rows)
        for i in range(LANES):
            if not i & step:
                a, b = rows[i], rows[i | step]
                result[i] = builder.shuffle_vector(a, b, ir.Constant(INTS, first))
                result[i | step] = builder.shuffle_vector(a, b, ir.Constant(INTS, second))
        rows = result
    return rows


@intrinsic
def store_transposed(typingctx, array, index, vectors):
    """Store up to 16 vectors transposed: lane k of all vectors goes to the 16 floats from ``index + 16 k`` on.

    Missing vectors are zero.
    """

    def codegen(context, builder, sig, args):
        rows = cgutils.unpack_tuple(builder, args[2], len(vectors))
        rows += [ir.Constant(FLOATS, None)] * (LANES - len(rows))
        for lane, row in enumerate(_transposed(builder, rows)):
            position = builder.add(args[1], ir.Constant(I64, LANES * lane))
            pointer = pointer_to(context, builder, sig.args[0], args[0], position)
            builder.store(row, builder.bitcast(pointer, FLOATS.as_pointer()), align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, vectors), codegen


def _load_columns(context, builder, sig, args):
    rows = []
    for lane in range(LANES):
        position = builder.add(args[1], ir.Constant(I64, LANES * lane))
        pointer = pointer_to(context, builder, sig.args[0], args[0], position)
        rows.append(builder.load(builder.bitcast(pointer, FLOATS.as_pointer()), align=4, typ=FLOATS))
    return _transposed(builder, rows)


@intrinsic
def load_transposed(typingctx, array, index):
    """Load 16 vectors transposed: lane k of all vectors is in the 16 floats from ``index + 16 k`` on."""

    def codegen(context, builder, sig, args):
        return context.make_tuple(builder, sig.return_type, _load_columns(context, builder, sig, args))

    return types.UniTuple(floats, LANES)(array, types.intp), codegen


@intrinsic
def load_rows_transposed(typingctx, array, keys, index):
    """Load 16 vectors transposed: lane k of all vectors is in the 16 floats from ``16 r`` on.

    ``r`` is in the low 32 bits of ``keys[index + k]``.
    """

    def codegen(context, builder, sig, args):
        lines = []
        for lane in range(LANES):
            at = builder.add(args[2], ir.Constant(I64, lane))
            key = builder.load(pointer_to(context, builder, sig.args[1], args[1], at))
            row = builder.and_(key, ir.Constant(I64, 0xFFFFFFFF))
            pointer = pointer_to(context, builder, sig.args[0], args[0], builder.mul(row, ir.Constant(I64, LANES)))
            lines.append(builder.load(builder.bitcast(pointer, FLOATS.as_pointer()), align=4, typ=FLOATS))
        return context.make_tuple(builder, sig.return_type, _transposed(builder, lines))

    return types.UniTuple(floats, LANES)(array, keys, types.intp), codegen


def _repeated(lanes):
    """Return an intrinsic that loads four floats from ``index`` on, float ``lanes[k]`` into lane k."""

    def codegen(context, builder, sig, args):
        kind = ir.VectorType(F32, 4)
        pointer = pointer_to(context, builder, sig.args[0], args[0], args[1])
        four = builder.load(builder.bitcast(pointer, kind.as_pointer()), align=4, typ=kind)
        return builder.shuffle_vector(four, ir.Constant(kind, ir.Undefined), ir.Constant(INTS, lanes))

    return intrinsic(lambda typingctx, array, index: (floats(array, types.intp), codegen))


load_columns = _repeated([lane % 4 for lane in range(LANES)])  # one float per column of a block of 4 x 4 pixels
load_lines = _repeated([lane // 4 for lane in range(LANES)])  # one float per row of a block


def _four(builder, vector, row):
    """Return lanes 4 row to 4 row + 3 of a vector."""
    picked = ir.Constant(ir.VectorType(I32, 4), [4 * row + x for x in range(4)])
    return builder.shuffle_vector(vector, ir.Constant(vector.type, ir.Undefined), picked)


@intrinsic
def store_block(typingctx, array, index, stride, value):
    """Store a block of 4 x 4 pixels in an image with ``stride`` floats per row; ``index`` is its first pixel."""

    def codegen(context, builder, sig, args):
        for row in range(4):
            at = builder.add(args[1], builder.mul(args[2], ir.Constant(I64, row)))
            pointer = pointer_to(context, builder, sig.args[0], args[0], at)
            four = _four(builder, args[3], row)
            builder.store(four, builder.bitcast(pointer, four.type.as_pointer()), align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, types.intp, floats), codegen


@intrinsic
def load_block(typingctx, array, index, stride):
    """Load a block of 4 x 4 pixels from an image with ``stride`` floats per row; ``index`` is its first pixel."""

    def codegen(context, builder, sig, args):
        kind, rows = ir.VectorType(F32, 4), []
        for row in range(4):
            at = builder.add(args[1], builder.mul(args[2], ir.Constant(I64, row)))
            pointer = pointer_to(context, builder, sig.args[0], args[0], at)
            rows.append(builder.load(builder.bitcast(pointer, kind.as_pointer()), align=4, typ=kind))
        eight = ir.Constant(ir.VectorType(I32, 8), list(range(8)))
        halves = [builder.shuffle_vector(rows[i], rows[i + 1], eight) for i in (0, 2)]
        return builder.shuffle_vector(*halves, ir.Constant(INTS, list(range(LANES))))

    return floats(array, types.intp, types.intp), codegen


@intrinsic
def store_color_block(typingctx, array, index, stride, r, g, b):
    """Store three channels of a block of 4 x 4 pixels in an image with interleaved channels: four rows of 12 floats."""

    def codegen(context, builder, sig, args):
        _, _, _, r, g, b = args
        twelve, kind = ir.VectorType(I32, 12), ir.VectorType(F32, 12)
        for row in range(4):
            fours = [_four(builder, channel, row) for channel in (r, g, b)]
            pairs = ir.Constant(twelve, [(x // 3) + 4 * min(x % 3, 1) for x in range(12)])
            mixed = builder.shuffle_vector(fours[0], fours[1], pairs)  # r g ? r g ? ...
            widened = builder.shuffle_vector(
                fours[2], ir.Constant(fours[2].type, ir.Undefined), ir.Constant(twelve, [x // 3 for x in range(12)])
            )
            value = builder.shuffle_vector(
                mixed, widened, ir.Constant(twelve, [x if x % 3 < 2 else 12 + x for x in range(12)])
            )
            at = builder.add(args[1], builder.mul(args[2], ir.Constant(I64, row)))
            pointer = pointer_to(context, builder, sig.args[0], args[0], at)
            builder.store(value, builder.bitcast(pointer, kind.as_pointer()), align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, types.intp, floats, floats, floats), codegen


@intrinsic
def load_color_block(typingctx, array, index, stride):
    """Load three channels of a block of 4 x 4 pixels from an image with interleaved channels."""

    def codegen(context, builder, sig, args):
        kind, rows = ir.VectorType(F32, 12), []
        for row in range(4):
            at = builder.add(args[1], builder.mul(args[2], ir.Constant(I64, row)))
            pointer = pointer_to(context, builder, sig.args[0], args[0], at)
            rows.append(builder.load(builder.bitcast(pointer, kind.as_pointer()), align=4, typ=kind))
        channels = []
        for channel in range(3):
            eight = ir.Constant(ir.VectorType(I32, 8), [12 * (x // 4) + 3 * (x % 4) + channel for x in range(8)])
            halves = [builder.shuffle_vector(rows[i], rows[i + 1], eight) for i in (0, 2)]
            channels.append(builder.shuffle_vector(*halves, ir.Constant(INTS, list(range(LANES)))))
        return context.make_tuple(builder, sig.return_type, channels)

    return types.UniTuple(floats, 3)(array, types.intp, types.intp), codegen


def _sum_plan():
    """Return the lane shuffles of a tree that adds up the lanes of 16 vectors, and the lane in which each sum ends."""
    quarters = range(0, LANES, 4)
    halves = list(range(8))
    pairs = [lane for lane in range(LANES) if not lane & 4]
    plan = [
        (halves + [LANES + x for x in halves], 8),
        (pairs + [LANES + x for x in pairs], 4),
        # From here on within 128 bits, which is faster.
        ([q + x for q in quarters for x in (0, 1, LANES, LANES + 1)], 2),
        ([q + x for q in quarters for x in (0, 2, LANES, LANES + 2)], 1),
    ]
    vectors = [[number] * LANES for number in range(LANES)]
    for low, _ in plan:
        vectors = [[(vectors[i] + vectors[i + 1])[x] for x in low] for i in range(0, len(vectors), 2)]
    return [(low, [x + distance for x in low]) for low, distance in plan], vectors[0]


_SUM_ROUNDS, SUM_LANES = _sum_plan()


@intrinsic
def sums(typingctx, vectors):
    """Return the sums over the lanes of up to 16 vectors as one vector, in the lane order of `SUM_LANES`."""

    def codegen(context, builder, sig, args):
        level = cgutils.unpack_tuple(builder, args[0], len(vectors))
        level += [None] * (LANES - len(level))
        zero = ir.Constant(FLOATS, None)
        for low, high in _SUM_ROUNDS:
            folded = []
            for a, b in zip(level[::2], level[1::2]):
                if a is None and b is None:
                    folded.append(None)
                    continue
                a, b = zero if a is None else a, zero if b is None else b
                lower = builder.shuffle_vector(a, b, ir.Constant(INTS, low))
                upper = builder.shuffle_vector(a, b, ir.Constant(INTS, high))
                folded.append(builder.fadd(lower, upper))
            level = folded
        return level[0]

    return floats(vectors), codegen


@intrinsic
def load_sums(typingctx, array, index):
    """Load 16 consecutive results of `sums`: lane j of returned vector k is the sum of vector k in result j."""

    def codegen(context, builder, sig, args):
        columns = _load_columns(context, builder, sig, args)
        ordered = [columns[SUM_LANES.index(k)] for k in range(LANES)]
        return context.make_tuple(builder, sig.return_type, ordered)

    return types.UniTuple(floats, LANES)(array, types.intp), codegen
