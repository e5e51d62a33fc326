"""Compiled kernels of the CPU rasteriser, on 16-lane SIMD values.

The picture is cut into tiles of 32 x 32 pixels = 8 x 8 blocks of 4 x 4 pixels; a block is one vector, and the blocks of
a tile that a Gaussian reaches are the bits of one uint64. One rendering goes through

    prepare  per chunk of 1024 Gaussians: 64-byte records, block bitmaps, how many (tile, Gaussian) entries there are;
             serial: where the entries of every tile and chunk go; per chunk: the entries
    blend    per tile: sort by depth (exact float order, ties by index), blend front to back
    compare  per strip of columns: losses, SSIM and the gradient images
    unblend  per tile: front to back again; one 16-float slot of sums per entry;
             per chunk: sum the slots, back through the projection, Adam or dense gradients

and where the loss is pixelwise, ``fuse`` does all after ``prepare``, blending, comparing and going back for one tile
after the other. Between the parts of a kernel threads wait for each other in the kernel: waking them anew takes longer.

Every partial result has its own fixed place, so results do not depend on the number of threads. Chunks, tiles and rows
are handed out by atomic counters.

SIMD types and kernels share this one file on purpose: numba's on-disk cache watches only the file a kernel is in.
What made it fast: ``../shared/research/rasteriser.md``, section 4.
"""

# mypy: ignore-errors
# (the arguments of kernels have numba's types, and intrinsics are called without their typing context)

from __future__ import annotations

import operator

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.core.typing.templates import ConcreteTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model

from activestructure_gym.compiling import kernel as _entry

# Only called from other kernels: Python's way in, which would be compiled along, is left out. So is counting references
# to arrays: eight atomic additions per block of Gaussians, on cache lines that all threads share. It leaves such
# functions unable to allocate; the few that must are `_allocating`. Where a function is called with different numbers
# they go through np.int64: numba compiles a function anew for every literal.
_plain = {"error_model": "numpy", "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
_inner, _inline = njit(_nrt=False, **_plain), njit(_nrt=False, forceinline=True, **_plain)
_allocating = njit(**_plain)

F = np.float32
LANES = 16
CHUNK = 1024  # Gaussians per unit of work
TILE = 32  # pixels
RECORD = 16  # floats per Gaussian, 64 bytes
ROWS = 14  # of the parameter array
DIGITS = 2048  # of the depth sort
SCRATCH = 400_000  # floats per thread: the blocks of a tile and 24,500 alphas of 16 pixels, well within a second cache
# Counters: of work handed out (before these), of threads, of alphas kept, of work that is done; how many entries there
# are; whether somebody has given up waiting.
THREAD_TICKET, KEPT_TICKET, PROJECTED, PLANNED, FILLED, TILES_DONE, STEPPED, ENTRIES, GIVEN_UP, TICKETS = range(7, 17)
_PATIENCE = 1 << 19  # looks at a counter, about half a millisecond
# rates: a learning rate per row, then these. MODE says what the backward pass is for; ISOTROPIC (0 or 1) ties the three
# log-scales of a Gaussian together: each gets the derivative by all of them.
BETA1, BETA2, EPSILON, MODE, ISOTROPIC, RATES = range(14, 20)
POSE_ONLY, TO_GRADIENT, TO_ADAM = -1.0, 0.0, 1.0

# ---------------------------------------------------------------------------------------------------------------------
# 16-lane values: numba types whose operators become LLVM vector instructions (AVX-512, AVX2, SSE or NEON by LLVM).


class _Vector(types.Type):
    def __init__(self) -> None:
        super().__init__(name=type(self).__name__)


class Floats(_Vector):
    """16 float32."""


class Ints(_Vector):
    """16 int32."""


class Mask(_Vector):
    """16 bits."""


floats, ints, mask16 = Floats(), Ints(), Mask()
_F32, _I32, _I64, _BIT = ir.FloatType(), ir.IntType(32), ir.IntType(64), ir.IntType(1)
_FLOATS, _INTS, _MASK = (ir.VectorType(element, LANES) for element in (_F32, _I32, _BIT))
for _numba_type, _llvm_type in ((Floats, _FLOATS), (Ints, _INTS), (Mask, _MASK)):

    @register_model(_numba_type)
    class _Model(models.PrimitiveModel):
        def __init__(self, dmm, fe_type, llvm_type=_llvm_type) -> None:
            super().__init__(dmm, fe_type, llvm_type)


def _spread(builder, value):
    """The same number in every lane (vectors pass)."""
    if isinstance(value.type, ir.VectorType):
        return value
    vector = ir.VectorType(value.type, LANES)
    first = builder.insert_element(ir.Constant(vector, ir.Undefined), value, ir.Constant(_I32, 0))
    return builder.shuffle_vector(first, ir.Constant(vector, ir.Undefined), ir.Constant(_INTS, [0] * LANES))


def _operator(op, operand, scalar, result, emit) -> None:
    """Register ``op`` for vector-vector, vector-scalar and scalar-vector."""
    cases = [signature(result, operand, operand)]
    if scalar is not None:
        cases += [signature(result, operand, scalar), signature(result, scalar, operand)]
    infer_global(op)(type("Template", (ConcreteTemplate,), {"cases": cases}))

    def lower(context, builder, sig, args):
        return emit(builder, _spread(builder, args[0]), _spread(builder, args[1]))

    for case in cases:
        lower_builtin(op, *case.args)(lower)


for _op, _name in (
    (operator.add, "fadd"), (operator.sub, "fsub"), (operator.mul, "fmul"), (operator.truediv, "fdiv"),
    (operator.iadd, "fadd"), (operator.isub, "fsub"), (operator.imul, "fmul"),
):  # fmt: skip
    _operator(_op, floats, types.float32, floats, lambda b, x, y, name=_name: getattr(b, name)(x, y))
for _op, _name in ((operator.lt, "<"), (operator.le, "<="), (operator.gt, ">"), (operator.ge, ">=")):
    _operator(_op, floats, types.float32, mask16, lambda b, x, y, name=_name: b.fcmp_ordered(name, x, y))
for _op, _name in (
    (operator.add, "add"), (operator.sub, "sub"), (operator.lshift, "shl"), (operator.rshift, "ashr"),
    (operator.and_, "and_"), (operator.or_, "or_"),
):  # fmt: skip
    _operator(_op, ints, types.int32, ints, lambda b, x, y, name=_name: getattr(b, name)(x, y))
for _op, _name in ((operator.and_, "and_"), (operator.or_, "or_")):
    _operator(_op, mask16, None, mask16, lambda b, x, y, name=_name: getattr(b, name)(x, y))


def _call(builder, name, result, args):
    function = cgutils.get_or_insert_function(
        builder.module, ir.FunctionType(result, [arg.type for arg in args]), name
    )
    return builder.call(function, args)


def _as_floats(kind):
    return floats if isinstance(kind, Floats) else types.float32


def _elementwise(llvm_name, arity):
    """An intrinsic of ``arity`` float arguments, scalars broadcast."""

    def codegen(context, builder, sig, args):
        return _call(builder, f"{llvm_name}.v16f32", _FLOATS, [_spread(builder, arg) for arg in args])

    if arity == 1:
        return intrinsic(lambda typingctx, a: (floats(floats), codegen))
    return intrinsic(lambda typingctx, a, b, c: (floats(*map(_as_floats, (a, b, c))), codegen))


# fmuladd and not fma: without FMA hardware the latter becomes a library call per lane.
fma = _elementwise("llvm.fmuladd", 3)
sqrt = _elementwise("llvm.sqrt", 1)
floor = _elementwise("llvm.floor", 1)
ceil = _elementwise("llvm.ceil", 1)


@intrinsic
def neg(typingctx, a):
    return floats(floats), lambda context, builder, sig, args: builder.fneg(args[0])


@intrinsic
def spread(typingctx, a):
    return floats(types.float32), lambda context, builder, sig, args: _spread(builder, args[0])


@intrinsic
def sel(typingctx, mask, a, b):
    """Lane by lane ``a if mask else b``."""
    kind = ints if ints in (a, b) else floats
    scalar = types.int32 if kind is ints else types.float32
    arguments = [kind if isinstance(x, _Vector) else scalar for x in (a, b)]

    def codegen(context, builder, sig, args):
        return builder.select(args[0], _spread(builder, args[1]), _spread(builder, args[2]))

    return kind(mask16, *arguments), codegen


@intrinsic
def bits(typingctx, mask):
    """The mask as an integer, lane 0 lowest."""

    def codegen(context, builder, sig, args):
        return builder.zext(builder.bitcast(args[0], ir.IntType(16)), _I64)

    return types.int64(mask16), codegen


@intrinsic
def to_int(typingctx, a):
    return ints(floats), lambda context, builder, sig, args: builder.fptosi(args[0], _INTS)


@intrinsic
def to_float(typingctx, a):
    return floats(ints), lambda context, builder, sig, args: builder.sitofp(args[0], _FLOATS)


@intrinsic
def int_bits(typingctx, a):
    return ints(floats), lambda context, builder, sig, args: builder.bitcast(args[0], _INTS)


@intrinsic
def float_bits(typingctx, a):
    return floats(ints), lambda context, builder, sig, args: builder.bitcast(args[0], _FLOATS)


def _constant(values):
    def codegen(context, builder, sig, args):
        return ir.Constant(_FLOATS, [float(value) for value in values])

    return intrinsic(lambda typingctx: (floats(), codegen))


lane_index = _constant(range(LANES))
lane_x = _constant([(lane % 4) + 0.5 for lane in range(LANES)])  # pixel centres within a block
lane_y = _constant([(lane // 4) + 0.5 for lane in range(LANES)])


def _pointer(context, builder, array_type, array, index):
    data = context.make_array(array_type)(context, builder, value=array).data
    return builder.gep(data, [index], inbounds=True)


@intrinsic
def load(typingctx, array, index):
    """16 floats from a C-ordered float32 array, seen as flat."""

    def codegen(context, builder, sig, args):
        pointer = _pointer(context, builder, sig.args[0], args[0], args[1])
        return builder.load(builder.bitcast(pointer, _FLOATS.as_pointer()), align=4, typ=_FLOATS)

    return floats(array, types.intp), codegen


@intrinsic
def store(typingctx, array, index, value):
    def codegen(context, builder, sig, args):
        pointer = _pointer(context, builder, sig.args[0], args[0], args[1])
        builder.store(args[2], builder.bitcast(pointer, _FLOATS.as_pointer()), align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, floats), codegen


@intrinsic
def peek(typingctx, array, index):
    """One element of a C-ordered array seen as flat, without the wrap-around test of negative indices."""

    def codegen(context, builder, sig, args):
        return builder.load(_pointer(context, builder, sig.args[0], args[0], args[1]))

    return array.dtype(array, types.intp), codegen


@intrinsic
def poke(typingctx, array, index, value):
    def codegen(context, builder, sig, args):
        builder.store(args[2], _pointer(context, builder, sig.args[0], args[0], args[1]))
        return context.get_dummy_value()

    return types.void(array, types.intp, array.dtype), codegen


@intrinsic
def poke_add(typingctx, array, index, value):
    """Add to one element."""

    def codegen(context, builder, sig, args):
        pointer = _pointer(context, builder, sig.args[0], args[0], args[1])
        builder.store(builder.add(builder.load(pointer), args[2]), pointer)
        return context.get_dummy_value()

    return types.void(array, types.intp, array.dtype), codegen


@intrinsic
def peek_bits(typingctx, array, index):
    """The bits of one float32 as int64 (zero extended)."""

    def codegen(context, builder, sig, args):
        pointer = _pointer(context, builder, sig.args[0], args[0], args[1])
        return builder.zext(builder.load(builder.bitcast(pointer, _I32.as_pointer()), typ=_I32), _I64)

    return types.int64(array, types.intp), codegen


@intrinsic
def poke_bits(typingctx, array, index, value):
    """Store the low 32 bits of an integer in a float32 array."""

    def codegen(context, builder, sig, args):
        pointer = _pointer(context, builder, sig.args[0], args[0], args[1])
        builder.store(builder.trunc(args[2], _I32), builder.bitcast(pointer, _I32.as_pointer()))
        return context.get_dummy_value()

    return types.void(array, types.intp, types.int64), codegen


@intrinsic
def prefetch(typingctx, array, index):
    def codegen(context, builder, sig, args):
        pointer = _pointer(context, builder, sig.args[0], args[0], args[1])
        pointer = builder.bitcast(pointer, ir.IntType(8).as_pointer())
        kind = ir.FunctionType(ir.VoidType(), [pointer.type, _I32, _I32, _I32])
        function = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0")
        builder.call(function, [pointer, ir.Constant(_I32, 0), ir.Constant(_I32, 3), ir.Constant(_I32, 1)])
        return context.get_dummy_value()

    return types.void(array, types.intp), codegen


@intrinsic
def take_ticket(typingctx, counters, index):
    """Atomic fetch-and-add of 1."""

    def codegen(context, builder, sig, args):
        pointer = _pointer(context, builder, sig.args[0], args[0], args[1])
        return builder.atomic_rmw("add", pointer, ir.Constant(_I64, 1), "acq_rel")

    return types.int64(counters, types.intp), codegen


@intrinsic
def _read_ticket(typingctx, counters, index):
    """Atomic load; what was written before the counter was raised is there."""

    def codegen(context, builder, sig, args):
        return builder.load_atomic(_pointer(context, builder, sig.args[0], args[0], args[1]), "acquire", 8)

    return types.int64(counters, types.intp), codegen


@intrinsic
def take_tickets(typingctx, counters, index, count):
    """Atomic fetch-and-add of ``count``."""

    def codegen(context, builder, sig, args):
        pointer = _pointer(context, builder, sig.args[0], args[0], args[1])
        return builder.atomic_rmw("add", pointer, args[2], "monotonic")

    return types.int64(counters, types.intp, types.int64), codegen


@_inner
def _all_done(tickets, counter, units):
    """Wait until so many units of work are done.

    False if that takes too long: then a thread that holds a unit has lost its core, and whoever waits leaves the kernel
    and so sets the other core free. Counters stay as they are: the kernel called again goes on from there.
    """
    for _ in range(_PATIENCE):
        if _read_ticket(tickets, counter) >= units:
            return _read_ticket(tickets, GIVEN_UP) == 0  # nobody goes on without those who have left
    take_ticket(tickets, GIVEN_UP)
    return False


@intrinsic
def _to_line(typingctx, array):
    """How many floats into the array the next 64-byte boundary lies."""

    def codegen(context, builder, sig, args):
        data = context.make_array(sig.args[0])(context, builder, value=args[0]).data
        address = builder.ptrtoint(data, _I64)
        return builder.and_(builder.lshr(builder.neg(address), ir.Constant(_I64, 2)), ir.Constant(_I64, 15))

    return types.int64(array), codegen


@_allocating
def _scratch(size):
    """Floats that start on a cache line: vectors across two lines cost double."""
    room = np.empty(size + LANES, np.float32)
    start = _to_line(room)
    return room[start : start + size]


@intrinsic
def lowest_bit(typingctx, value):
    """Index of the lowest set bit of a value that is not 0."""

    def codegen(context, builder, sig, args):
        return builder.cttz(args[0], ir.Constant(_BIT, 1))

    return types.int64(types.int64), codegen


@intrinsic
def count_bits(typingctx, value):
    def codegen(context, builder, sig, args):
        return builder.ctpop(args[0])

    return types.int64(types.uint64), codegen


def _transposed(builder, rows):
    """16 vectors, rows to columns: four rounds of exchanging sub-blocks."""
    for step in (1, 2, 4, 8):
        first = [lane if not lane & step else LANES + lane - step for lane in range(LANES)]
        second = [lane + step if not lane & step else LANES + lane for lane in range(LANES)]
        result = list(rows)
        for i in range(LANES):
            if not i & step:
                a, b = rows[i], rows[i | step]
                result[i] = builder.shuffle_vector(a, b, ir.Constant(_INTS, first))
                result[i | step] = builder.shuffle_vector(a, b, ir.Constant(_INTS, second))
        rows = result
    return rows


@intrinsic
def store_transposed(typingctx, array, index, vectors):
    """Lane k of the (up to 16) vectors goes to floats ``index + 16 k ...``; missing vectors are zero."""

    def codegen(context, builder, sig, args):
        rows = cgutils.unpack_tuple(builder, args[2], len(vectors))
        rows += [ir.Constant(_FLOATS, None)] * (LANES - len(rows))
        for lane, row in enumerate(_transposed(builder, rows)):
            position = builder.add(args[1], ir.Constant(_I64, LANES * lane))
            pointer = _pointer(context, builder, sig.args[0], args[0], position)
            builder.store(row, builder.bitcast(pointer, _FLOATS.as_pointer()), align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, vectors), codegen


def _load_columns(context, builder, sig, args):
    rows = []
    for lane in range(LANES):
        position = builder.add(args[1], ir.Constant(_I64, LANES * lane))
        pointer = _pointer(context, builder, sig.args[0], args[0], position)
        rows.append(builder.load(builder.bitcast(pointer, _FLOATS.as_pointer()), align=4, typ=_FLOATS))
    return _transposed(builder, rows)


@intrinsic
def load_transposed(typingctx, array, index):
    """The inverse of `store_transposed`: 16 vectors, lane k of each from floats ``index + 16 k ...``."""

    def codegen(context, builder, sig, args):
        return context.make_tuple(builder, sig.return_type, _load_columns(context, builder, sig, args))

    return types.UniTuple(floats, LANES)(array, types.intp), codegen


def _four(builder, vector, row):
    """Lanes 4 row .. 4 row + 3."""
    picked = ir.Constant(ir.VectorType(_I32, 4), [4 * row + x for x in range(4)])
    return builder.shuffle_vector(vector, ir.Constant(vector.type, ir.Undefined), picked)


@intrinsic
def store_block(typingctx, array, index, stride, value):
    """A block of 4 x 4 pixels into an image with ``stride`` floats per row."""

    def codegen(context, builder, sig, args):
        for row in range(4):
            at = builder.add(args[1], builder.mul(args[2], ir.Constant(_I64, row)))
            pointer = _pointer(context, builder, sig.args[0], args[0], at)
            four = _four(builder, args[3], row)
            builder.store(four, builder.bitcast(pointer, four.type.as_pointer()), align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, types.intp, floats), codegen


@intrinsic
def load_block(typingctx, array, index, stride):
    def codegen(context, builder, sig, args):
        kind, rows = ir.VectorType(_F32, 4), []
        for row in range(4):
            at = builder.add(args[1], builder.mul(args[2], ir.Constant(_I64, row)))
            pointer = _pointer(context, builder, sig.args[0], args[0], at)
            rows.append(builder.load(builder.bitcast(pointer, kind.as_pointer()), align=4, typ=kind))
        eight = ir.Constant(ir.VectorType(_I32, 8), list(range(8)))
        halves = [builder.shuffle_vector(rows[i], rows[i + 1], eight) for i in (0, 2)]
        return builder.shuffle_vector(*halves, ir.Constant(_INTS, list(range(LANES))))

    return floats(array, types.intp, types.intp), codegen


@intrinsic
def store_color_block(typingctx, array, index, stride, r, g, b):
    """Three channels of a block, interleaved: rows of 12 floats."""

    def codegen(context, builder, sig, args):
        _, _, _, r, g, b = args
        twelve, kind = ir.VectorType(_I32, 12), ir.VectorType(_F32, 12)
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
            at = builder.add(args[1], builder.mul(args[2], ir.Constant(_I64, row)))
            pointer = _pointer(context, builder, sig.args[0], args[0], at)
            builder.store(value, builder.bitcast(pointer, kind.as_pointer()), align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, types.intp, floats, floats, floats), codegen


@intrinsic
def load_color_block(typingctx, array, index, stride):
    """The three channels of a block from interleaved rows."""

    def codegen(context, builder, sig, args):
        kind, rows = ir.VectorType(_F32, 12), []
        for row in range(4):
            at = builder.add(args[1], builder.mul(args[2], ir.Constant(_I64, row)))
            pointer = _pointer(context, builder, sig.args[0], args[0], at)
            rows.append(builder.load(builder.bitcast(pointer, kind.as_pointer()), align=4, typ=kind))
        channels = []
        for channel in range(3):
            eight = ir.Constant(
                ir.VectorType(_I32, 8), [12 * (x // 4) + 3 * (x % 4) + channel for x in range(8)]
            )
            halves = [builder.shuffle_vector(rows[i], rows[i + 1], eight) for i in (0, 2)]
            channels.append(builder.shuffle_vector(*halves, ir.Constant(_INTS, list(range(LANES)))))
        return context.make_tuple(builder, sig.return_type, channels)

    return types.UniTuple(floats, 3)(array, types.intp, types.intp), codegen


def _sum_plan():
    """Shuffles of a tree that adds up 16 vectors, and in which lane the sum of each ends."""
    quarters = range(0, LANES, 4)
    halves = list(range(8))
    pairs = [lane for lane in range(LANES) if not lane & 4]
    plan = [
        (halves + [LANES + x for x in halves], 8),
        (pairs + [LANES + x for x in pairs], 4),
        ([q + x for q in quarters for x in (0, 1, LANES, LANES + 1)], 2),  # from here on within 128 bits: cheap
        ([q + x for q in quarters for x in (0, 2, LANES, LANES + 2)], 1),
    ]
    vectors = [[number] * LANES for number in range(LANES)]
    for low, _ in plan:
        vectors = [[(vectors[i] + vectors[i + 1])[x] for x in low] for i in range(0, len(vectors), 2)]
    return [(low, [x + distance for x in low]) for low, distance in plan], vectors[0]


_SUM_ROUNDS, SUM_LANES = _sum_plan()


@intrinsic
def sums(typingctx, vectors):
    """The sums over the lanes of up to 16 vectors as one vector, in the lane order of `load_sums`."""

    def codegen(context, builder, sig, args):
        level = cgutils.unpack_tuple(builder, args[0], len(vectors))
        level += [None] * (LANES - len(level))
        zero = ir.Constant(_FLOATS, None)
        for low, high in _SUM_ROUNDS:
            folded = []
            for a, b in zip(level[::2], level[1::2]):
                if a is None and b is None:
                    folded.append(None)
                    continue
                a, b = zero if a is None else a, zero if b is None else b
                lower = builder.shuffle_vector(a, b, ir.Constant(_INTS, low))
                upper = builder.shuffle_vector(a, b, ir.Constant(_INTS, high))
                folded.append(builder.fadd(lower, upper))
            level = folded
        return level[0]

    return floats(vectors), codegen


@intrinsic
def load_sums(typingctx, array, index):
    """From 16 results of `sums` in a row at ``index``: the sum of vector k of result j is lane j of entry k."""

    def codegen(context, builder, sig, args):
        columns = _load_columns(context, builder, sig, args)
        ordered = [columns[SUM_LANES.index(k)] for k in range(LANES)]
        return context.make_tuple(builder, sig.return_type, ordered)

    return types.UniTuple(floats, LANES)(array, types.intp), codegen


# ---------------------------------------------------------------------------------------------------------------------
# Numbers of the model (gsplat's) and layouts.

NEAR_PLANE = F(0.01)
BLUR_VARIANCE = F(0.3)  # px^2
MIN_TRANSMITTANCE = F(1e-4)
CLAMP_MARGIN = 0.3  # of half the image
LOG2_E = F(1.4426950408889634)
LOG2_255 = F(7.994353436858858)
ROOT = F(0.8493218002880191)  # sqrt(log2(e) / 2): alpha = 2^(lo - t^2 - s^2)
LN_4 = F(1.3862943611198906)  # 1 / ROOT^2
SLACK = F(0.01)  # px around every ellipse, far above the rounding of its border

# view: floats of a camera
POSE, FX, FY, CX, CY, LOW_X, HIGH_X, LOW_Y, HIGH_Y, MAX_ALPHA, CONSTANTS, VIEW_SIZE = 0, *range(12, 22), 32
# grid: integers of a rendering
COUNT, CAPACITY, WIDTH, HEIGHT, TILES_X, TILES_Y, CHUNKS, BLOCKS_X, BLOCKS_Y, STRIDE, MARGIN = range(11)
TILE_BLOCKS, GRID_SIZE = 11, 12  # 64, as a number that the compiler does not know: it would unroll the loops
# record: t = L00 dx + L01 dy, s = L11 dy; BOX_X and BOX_Y hold first + last << 16 in blocks; SLOT.. are set by fill
U, V, L00, L01, L11, LOG_OPACITY, RED, GREEN, BLUE, DEPTH, BOX_X, BOX_Y, BITMAP, SLOT, SLOTS = (*range(13), 14, 15)
# rows of the array of entries
KEY, KEY_2, SPLAT_KEY, REACH, SORTED_REACH, SORTED_SPLAT, ENTRY_ROWS = range(7)
# sums of a slot
V_, VT, VS, VTT, VTS, VSS, W_RED, W_GREEN, W_BLUE, W_DEPTH, W_ALL = range(11)

_BLOCK_X = np.array([4 * (block % 8) for block in range(64)], np.float32)
_BLOCK_Y = np.array([4 * (block // 8) for block in range(64)], np.float32)


@_inline
def _exp2(x):
    """2 ** x for -126 < x < 126; 1 + f Q(f), so that it is most exact near 1 where 1 - alpha matters."""
    shifted = x + F(12582912.0)  # 1.5 * 2^23: the low bits now hold the nearest integer
    f = x - (shifted - F(12582912.0))
    q = fma(f, fma(f, fma(f, fma(f, F(1.3264725e-3), F(9.6715127e-3)), F(5.5507337e-2)), F(0.24022242)), F(0.69314698))
    return float_bits(int_bits(fma(f, q, F(1.0))) + (int_bits(shifted) << np.int32(23)))


# The numbers of the hot loops, as memory operands behind every view: as literals LLVM hoists them out of the loop and
# spills them to a stack that is not aligned to 64 bytes, where every reload takes two cache lines.
MAGIC, EXP_5, EXP_4, EXP_3, EXP_2, EXP_1, ONE, LEAST_POWER, LEAST_LEFT = range(CONSTANTS, CONSTANTS + 9)
CONSTANT_VALUES = np.array(
    [12582912.0, 1.3264725e-3, 9.6715127e-3, 5.5507337e-2, 0.24022242, 0.69314698, 1.0, -LOG2_255, MIN_TRANSMITTANCE],
    np.float32,
)


@_inline
def _exp2_hot(x, view):
    """`_exp2` with its constants from memory."""
    shifted = x + peek(view, MAGIC)
    f = x - (shifted - peek(view, MAGIC))
    q = fma(f, spread(peek(view, EXP_5)), peek(view, EXP_4))
    q = fma(f, fma(f, fma(f, q, peek(view, EXP_3)), peek(view, EXP_2)), peek(view, EXP_1))
    return float_bits(int_bits(fma(f, q, peek(view, ONE))) + (int_bits(shifted) << np.int32(23)))


@_inline
def _log2(x):
    """log2 of normal positive numbers: exponent, and atanh series of the mantissa in [1/sqrt 2, sqrt 2)."""
    whole = (int_bits(x) - np.int32(0x3F3504F3)) >> np.int32(23)
    mantissa = float_bits(int_bits(x) - (whole << np.int32(23)))
    y = (mantissa - F(1.0)) / (mantissa + F(1.0))
    square = y * y
    series = fma(square, fma(square, fma(square, fma(square, F(0.32059890), F(0.41219858)), F(0.57707802)),
                             F(0.96179669)), F(2.88539008))  # fmt: skip
    return fma(y, series, to_float(whole))


@_inline
def _least(a, b):
    return sel(a < b, a, b)


@_inline
def _most(a, b):
    return sel(a > b, a, b)


@_inline
def _clamped(value, low, high):
    return _least(_most(value, low), high)


@_inline
def _dot3(a0, a1, a2, b0, b1, b2):
    return fma(a2, b2, fma(a1, b1, a0 * b0))


@_inline
def _camera_point(parameters, capacity, i, view):
    mx, my, mz = load(parameters, i), load(parameters, capacity + i), load(parameters, 2 * capacity + i)
    x = fma(mz, view[2], fma(my, view[1], fma(mx, view[0], view[3])))
    y = fma(mz, view[6], fma(my, view[5], fma(mx, view[4], view[7])))
    z = fma(mz, view[10], fma(my, view[9], fma(mx, view[8], view[11])))
    return x, y, z


@_inline
def _scale(parameters, capacity, i, axis):
    return _exp2(_clamped(load(parameters, (7 + axis) * capacity + i) * LOG2_E, spread(F(-60.0)), spread(F(60.0))))


@_inline
def _rotation(parameters, capacity, i):
    """Unit quaternion, 1 / its length before, and the 9 entries of the matrix."""
    w, x = load(parameters, 3 * capacity + i), load(parameters, 4 * capacity + i)
    y, z = load(parameters, 5 * capacity + i), load(parameters, 6 * capacity + i)
    inverse = spread(F(1.0)) / sqrt(fma(w, w, fma(x, x, fma(y, y, z * z))))
    w, x, y, z = w * inverse, x * inverse, y * inverse, z * inverse
    x2, y2, z2 = x + x, y + y, z + z
    one = spread(F(1.0))
    matrix = (
        one - fma(y, y2, z * z2), fma(x, y2, neg(w * z2)), fma(x, z2, w * y2),
        fma(x, y2, w * z2), one - fma(x, x2, z * z2), fma(y, z2, neg(w * x2)),
        fma(x, z2, neg(w * y2)), fma(y, z2, w * x2), one - fma(x, x2, y * y2),
    )  # fmt: skip
    return (w, x, y, z), inverse, matrix


@_inline
def _jacobian(x, y, inverse_z, view):
    """J00, J02, J11, J12 of the projection and the clamped slopes."""
    slope_x = _clamped(x * inverse_z, spread(view[LOW_X]), spread(view[HIGH_X]))
    slope_y = _clamped(y * inverse_z, spread(view[LOW_Y]), spread(view[HIGH_Y]))
    j00, j11 = inverse_z * view[FX], inverse_z * view[FY]
    return j00, neg(j00 * slope_x), j11, neg(j11 * slope_y), slope_x, slope_y


@_inline
def _opacity(parameters, capacity, i):
    """Opacity, its complement (not by subtraction: it multiplies gradients) and its log2."""
    power = load(parameters, 10 * capacity + i) * neg(spread(LOG2_E))
    e = _exp2(_most(_least(power, spread(F(80.0))), spread(F(-80.0))))  # in this order not-a-number becomes opacity 0
    one_more = e + F(1.0)
    opacity = spread(F(1.0)) / one_more
    return opacity, e * opacity, neg(_log2(one_more))


@_inner
def _project_block(parameters, i, view, grid, records):
    """Records of Gaussians i .. i + 15; returns the bits of those that reach a pixel block of the image."""
    capacity = grid[CAPACITY]
    x, y, z = _camera_point(parameters, capacity, i, view)
    live = (z >= NEAR_PLANE) & (lane_index() < F(grid[COUNT] - i))
    if bits(live) == 0:
        return np.int64(0)
    inverse_z = spread(F(1.0)) / sel(live, z, F(1.0))
    u, v = fma(x * inverse_z, view[FX], view[CX]), fma(y * inverse_z, view[FY], view[CY])
    j00, j02, j11, j12, _, _ = _jacobian(x, y, inverse_z, view)
    # A cheap bound first: 3.34 sigma of the largest axis through the norm of the Jacobian *at the clamped slope*.
    log0, log1, log2 = (
        load(parameters, 7 * capacity + i), load(parameters, 8 * capacity + i), load(parameters, 9 * capacity + i)
    )  # fmt: skip
    live = live & (log0 < F(40.0)) & (log1 < F(40.0)) & (log2 < F(40.0))  # not so for what is not a number
    largest = _exp2(_clamped(_most(log0, _most(log1, log2)) * LOG2_E, spread(F(-60.0)), spread(F(60.0))))
    norm = _dot3(j00, j02, j11, j00, j02, j11) + j12 * j12
    reach = sqrt(fma(norm * largest, largest, BLUR_VARIANCE)) * F(3.34)
    width, height = F(grid[WIDTH]), F(grid[HEIGHT])
    live = live & (u + reach > F(0.0)) & (u - reach < width) & (v + reach > F(0.0)) & (v - reach < height)
    if bits(live) == 0:
        return np.int64(0)

    s0 = _scale(parameters, capacity, i, np.int64(0))
    s1 = _scale(parameters, capacity, i, np.int64(1))
    s2 = _scale(parameters, capacity, i, np.int64(2))
    _, _, r = _rotation(parameters, capacity, i)
    a0, a1, a2 = fma(j02, view[8], j00 * view[0]), fma(j02, view[9], j00 * view[1]), fma(j02, view[10], j00 * view[2])
    b0, b1, b2 = fma(j12, view[8], j11 * view[4]), fma(j12, view[9], j11 * view[5]), fma(j12, view[10], j11 * view[6])
    p0, p1, p2 = (
        _dot3(a0, a1, a2, r[0], r[3], r[6]) * s0,
        _dot3(a0, a1, a2, r[1], r[4], r[7]) * s1,
        _dot3(a0, a1, a2, r[2], r[5], r[8]) * s2,
    )
    n0, n1, n2 = (
        _dot3(b0, b1, b2, r[0], r[3], r[6]) * s0,
        _dot3(b0, b1, b2, r[1], r[4], r[7]) * s1,
        _dot3(b0, b1, b2, r[2], r[5], r[8]) * s2,
    )
    xx, yy = _dot3(p0, p1, p2, p0, p1, p2), _dot3(n0, n1, n2, n0, n1, n2)
    xy = _dot3(p0, p1, p2, n0, n1, n2)
    # |p x n|^2 instead of xx yy - xy^2: no cancellation for needles.
    c0, c1, c2 = fma(p1, n2, neg(p2 * n1)), fma(p2, n0, neg(p0 * n2)), fma(p0, n1, neg(p1 * n0))
    determinant = fma(xx + yy, BLUR_VARIANCE, _dot3(c0, c1, c2, c0, c1, c2)) + BLUR_VARIANCE * BLUR_VARIANCE
    xx, yy = xx + BLUR_VARIANCE, yy + BLUR_VARIANCE
    _, _, log_opacity = _opacity(parameters, capacity, i)
    inside = log_opacity + LOG2_255  # t^2 + s^2 up to here is seen
    live = live & (inside >= F(0.0)) & (determinant > F(0.0))
    inside = sel(live, inside, F(0.0))
    one = spread(F(1.0))
    root_yy, root_determinant = sqrt(yy), sqrt(determinant)
    l11 = one / root_yy * ROOT
    l00 = root_yy / root_determinant * ROOT
    l01 = neg(xy) / (root_yy * root_determinant) * ROOT
    live = live & (l00 > F(0.0)) & (l11 > F(0.0))  # not so where a covariance overflows

    # The box of the ellipse in blocks whose pixel centres it can contain.
    root = sqrt(inside) * (one / ROOT)
    root_xx = sqrt(xx)
    radius_x, radius_y = root * root_xx + SLACK, root * root_yy + SLACK
    far = spread(F(1e6))
    quarter = F(0.25)
    box_x0 = _most(ceil((_most(u - radius_x, neg(far)) - F(3.5)) * quarter), spread(F(0.0)))
    box_y0 = _most(ceil((_most(v - radius_y, neg(far)) - F(3.5)) * quarter), spread(F(0.0)))
    box_x1 = _least(floor((_least(u + radius_x, far) - F(0.5)) * quarter), spread(F(grid[BLOCKS_X] - 1)))
    box_y1 = _least(floor((_least(v + radius_y, far) - F(0.5)) * quarter), spread(F(grid[BLOCKS_Y] - 1)))
    live = live & (box_x0 <= box_x1) & (box_y0 <= box_y1)
    if bits(live) == 0:
        return np.int64(0)

    # One byte of blocks per band of four pixel rows, from the ellipse's x-interval over the band.
    skew, half = l01 / l00, one / l00
    turning = xy / root_xx * root  # dy of the rightmost point
    low = int_bits(spread(F(0.0)))
    high = low
    ones = low + np.int32(1)
    for band in range(8):
        if bits(live & (box_y0 + F(band) <= box_y1)) == 0:
            break
        top = fma(box_y0 + F(band), F(4.0), F(0.5)) - v
        from_y, to_y = _most(top, neg(radius_y)), _least(top + F(3.0), radius_y)
        at = _clamped(turning, from_y, to_y)
        step = l11 * at
        right = u - skew * at + half * sqrt(_most(inside - step * step, spread(F(0.0)))) + SLACK
        at = _clamped(neg(turning), from_y, to_y)
        step = l11 * at
        left = u - skew * at - half * sqrt(_most(inside - step * step, spread(F(0.0)))) - SLACK
        first = _most(ceil((left - F(3.5)) * quarter), box_x0) - box_x0
        last = _least(floor((right - F(0.5)) * quarter), box_x1) - box_x0
        some = (from_y <= to_y) & (first <= last) & (box_y0 + F(band) <= box_y1)
        first, last = _least(first, spread(F(8.0))), _clamped(last, spread(F(0.0)), spread(F(7.0)))
        byte = ((ones + ones) << to_int(last)) - (ones << to_int(first))
        byte = sel(some, byte, np.int32(0))
        if band < 4:
            low = low | (byte << np.int32(8 * band))
        else:
            high = high | (byte << np.int32(8 * band - 32))
    box_x = to_int(box_x0) + (to_int(box_x1) << np.int32(16))
    box_y = to_int(box_y0) + (to_int(box_y1) << np.int32(16))
    store_transposed(
        records, RECORD * i,
        (
            u, v, l00, l01, l11, log_opacity,
            load(parameters, 11 * capacity + i), load(parameters, 12 * capacity + i),
            load(parameters, 13 * capacity + i), z,
            float_bits(box_x), float_bits(box_y), float_bits(low), float_bits(high),
        ),
    )  # fmt: skip
    return bits(live)


# ---------------------------------------------------------------------------------------------------------------------
# Which tiles a Gaussian reaches.

_U64 = np.uint64
_COLUMNS_KEPT = np.array([0x0101010101010101 * (0xFF >> shift) for shift in range(8)], np.uint64)


@_inner
def _reach_of_large(records, base, tile_x, tile_y, last_x):
    """Blocks of a tile that an ellipse larger than 8 x 8 blocks touches; scalar, the same intervals as the bitmap."""
    u, v = peek(records, base + U), peek(records, base + V)
    l00, l01, l11 = peek(records, base + L00), peek(records, base + L01), peek(records, base + L11)
    inside = peek(records, base + LOG_OPACITY) + LOG2_255
    root = np.sqrt(max(inside, F(0.0)))
    radius_y = root / l11 + SLACK
    width = np.sqrt(l01 * l01 + l11 * l11)
    turning = -l01 * root / (l11 * width)
    reach = _U64(0)
    for band in range(8):
        top = F(4 * (8 * tile_y + band)) + F(0.5) - v
        from_y, to_y = max(top, -radius_y), min(top + F(3.0), radius_y)
        if from_y > to_y:
            continue
        at = min(max(turning, from_y), to_y)
        right = u - l01 / l00 * at + np.sqrt(max(inside - l11 * at * l11 * at, F(0.0))) / l00 + SLACK
        at = min(max(-turning, from_y), to_y)
        left = u - l01 / l00 * at - np.sqrt(max(inside - l11 * at * l11 * at, F(0.0))) / l00 - SLACK
        origin = F(TILE * tile_x)
        first = np.int64(max(np.ceil((max(left - origin, F(-1e6)) - F(3.5)) * F(0.25)), F(0.0)))
        last = np.int64(min(np.floor((min(right - origin, F(1e6)) - F(0.5)) * F(0.25)), F(min(7, last_x - 8 * tile_x))))
        if first <= last:
            reach |= _U64((2 << last) - (1 << first)) << _U64(8 * band)
    return reach


@_inline
def _reach(records, base, x0, y0, x1, y1, tile_x, tile_y):
    """The 64 blocks of a tile as bits: the Gaussian's own bitmap moved to the tile's corner."""
    if x1 - x0 > 7 or y1 - y0 > 7:
        return _reach_of_large(records, base, tile_x, tile_y, x1)
    reach = _U64(peek_bits(records, base + BITMAP)) | (_U64(peek_bits(records, base + BITMAP + 1)) << _U64(32))
    x, y = x0 - 8 * tile_x, y0 - 8 * tile_y
    if y >= 0:
        reach = reach << _U64(8 * y)
    else:
        reach = reach >> _U64(-8 * y)
    if x >= 0:
        return (reach & peek(_COLUMNS_KEPT, x)) << _U64(x)
    return (reach >> _U64(-x)) & peek(_COLUMNS_KEPT, -x)


@_inline
def _box(records, base):
    x, y = peek_bits(records, base + BOX_X), peek_bits(records, base + BOX_Y)
    return x & 0xFFFF, y & 0xFFFF, x >> 16, y >> 16


@_inline
def _one_tile(x0, y0, x1, y1):
    """Most boxes lie in one tile: no need to look at the blocks to count them."""
    return ((x0 ^ x1) | (y0 ^ y1)) < 8


@_inner
def _project_chunk(chunk, parameters, view, grid, records, visible, histogram, chunk_entries):
    """Project 1024 Gaussians and count their entries per tile.

    A chunk whose first entry of ``visible`` is negative is known to be out of view and is not looked at.
    """
    tiles_x = grid[TILES_X]
    tiles = tiles_x * grid[TILES_Y]
    for tile in range(tiles):
        poke(histogram, chunk * tiles + tile, np.int32(0))
    entries = 0
    first = chunk * CHUNK
    if peek(visible, first // LANES) < 0:
        for block in range(CHUNK // LANES):
            poke(visible, first // LANES + block, np.int32(0))
        first = grid[COUNT]
    for i in range(first, min((chunk + 1) * CHUNK, grid[COUNT]), LANES):
        seen = _project_block(parameters, i, view, grid, records)
        poke(visible, i // LANES, np.int32(seen))
        while seen != 0:
            base = RECORD * (i + lowest_bit(seen))
            seen &= seen - 1
            x0, y0, x1, y1 = _box(records, base)
            alone = _one_tile(x0, y0, x1, y1)
            for tile_y in range(y0 >> 3, (y1 >> 3) + 1):
                for tile_x in range(x0 >> 3, (x1 >> 3) + 1):
                    if alone or _reach(records, base, x0, y0, x1, y1, tile_x, tile_y) != _U64(0):
                        at = chunk * tiles + tile_y * tiles_x + tile_x
                        poke(histogram, at, peek(histogram, at) + np.int32(1))
                        entries += 1
    chunk_entries[chunk] = entries


PLACES = 258  # integers behind the tiles in ``tile_order``: room for ordering them


@_inner
def _order_tiles(tiles, tile_start, tile_order):
    """The tiles by falling number of entries, to a 256th of the largest, ties by index: a counting sort."""
    most = 1
    for rank in range(PLACES):
        poke(tile_order, tiles + rank, 0)
    for tile in range(tiles):
        most = max(most, tile_start[tile + 1] - tile_start[tile])
    for tile in range(tiles):
        poke_add(tile_order, tiles + 257 - 256 * (tile_start[tile + 1] - tile_start[tile]) // most, 1)
    for rank in range(1, PLACES):
        poke_add(tile_order, tiles + rank, peek(tile_order, tiles + rank - 1))
    for tile in range(tiles):
        place = tiles + 256 - 256 * (tile_start[tile + 1] - tile_start[tile]) // most
        poke(tile_order, peek(tile_order, place), tile)
        poke_add(tile_order, place, 1)


@_inner
def _plan(grid, histogram, chunk_entries, tile_start, tile_order):
    """Turn the counts into first places: of each chunk's entries in each tile, and of each chunk's slots.

    ``tile_order`` lists the tiles with most entries first: handed out so, all threads finish at nearly the same time.
    """
    tiles, chunks = grid[TILES_X] * grid[TILES_Y], grid[CHUNKS]
    for tile in range(tiles + 1):
        tile_start[tile] = 0
    for chunk in range(chunks):
        if chunk_entries[chunk] == 0:  # out of view, as most of a large map
            continue
        for tile in range(tiles):
            poke_add(tile_start, tile, np.int64(peek(histogram, chunk * tiles + tile)))
    total = 0
    for tile in range(tiles + 1):
        entries = tile_start[tile]
        tile_start[tile] = total
        total += entries
    for chunk in range(chunks):
        if chunk_entries[chunk] == 0:
            continue
        for tile in range(tiles):
            entries = np.int64(peek(histogram, chunk * tiles + tile))
            poke(histogram, chunk * tiles + tile, np.int32(peek(tile_start, tile)))
            poke_add(tile_start, tile, entries)
    for tile in range(tiles, 0, -1):  # each start has moved to the next one's
        tile_start[tile] = tile_start[tile - 1]
    tile_start[0] = 0
    slots = 0
    for chunk in range(chunks):
        entries = chunk_entries[chunk]
        chunk_entries[chunk] = slots
        slots += entries
    _order_tiles(tiles, tile_start, tile_order)
    return total


@_inner
def _fill_chunk(chunk, grid, records, visible, histogram, chunk_entries, entries):
    """Write the entries of a chunk; the slots of one Gaussian lie side by side."""
    tiles_x = grid[TILES_X]
    tiles, room = tiles_x * grid[TILES_Y], entries.shape[1]
    slot = chunk_entries[chunk]
    for i in range(chunk * CHUNK, min((chunk + 1) * CHUNK, grid[COUNT]), LANES):
        seen = np.int64(peek(visible, i // LANES))
        while seen != 0:
            splat = i + lowest_bit(seen)
            base = RECORD * splat
            seen &= seen - 1
            depth = _U64(peek_bits(records, base + DEPTH)) << _U64(32)
            x0, y0, x1, y1 = _box(records, base)
            poke_bits(records, base + SLOT, slot)
            first, alone = slot, _one_tile(x0, y0, x1, y1)
            for tile_y in range(y0 >> 3, (y1 >> 3) + 1):
                for tile_x in range(x0 >> 3, (x1 >> 3) + 1):
                    reach = _reach(records, base, x0, y0, x1, y1, tile_x, tile_y)
                    if alone or reach != _U64(0):  # the same rule as when counting
                        counter = chunk * tiles + tile_y * tiles_x + tile_x
                        at = np.int64(peek(histogram, counter))
                        poke(histogram, counter, np.int32(at + 1))
                        poke(entries, KEY * room + at, depth | _U64(at))
                        poke(entries, REACH * room + at, reach)
                        poke(entries, SPLAT_KEY * room + at, _U64(splat) | (_U64(slot) << _U64(32)))
                        slot += 1
            poke_bits(records, base + SLOTS, slot - first)


@_inner
def _sort_tile(start, stop, entries, digits):
    """Order the entries of a tile by depth, ties by index: radix on the float's bits (positive floats sort as such).

    Returns how many blocks they reach together.
    """
    room = entries.shape[1]
    source, target = KEY * room, KEY_2 * room
    count = stop - start
    if count <= 32:
        for i in range(start + 1, stop):
            key = peek(entries, source + i)
            j = i - 1
            while j >= start and peek(entries, source + j) > key:
                poke(entries, source + j + 1, peek(entries, source + j))
                j -= 1
            poke(entries, source + j + 1, key)
    else:
        nearest = farthest = peek(entries, source + start)
        for i in range(start, stop):
            key = peek(entries, source + i)
            nearest, farthest = min(nearest, key), max(farthest, key)
        # Only the bits in which depths of this tile differ from the nearest need sorting.
        nearest = nearest >> _U64(32)
        spare, width = (farthest >> _U64(32)) - nearest, 0
        while (spare >> _U64(width)) != _U64(0):
            width += 1
        most = 8 if count < 2048 else 11  # bits of a digit: its table has to be walked through as well
        rounds = (width + most - 1) // most
        width = (width + rounds - 1) // max(rounds, 1)
        shift, size = 0, 1 << width
        low = _U64(size - 1)
        for _ in range(rounds):
            for digit in range(size):
                poke(digits, digit, np.int64(0))
            for i in range(start, stop):
                digit = np.int64((((peek(entries, source + i) >> _U64(32)) - nearest) >> _U64(shift)) & low)
                poke(digits, digit, peek(digits, digit) + 1)
            place = start
            for digit in range(size):
                own = peek(digits, digit)
                poke(digits, digit, place)
                place += own
            for i in range(start, stop):
                key = peek(entries, source + i)
                digit = np.int64((((key >> _U64(32)) - nearest) >> _U64(shift)) & low)
                place = peek(digits, digit)
                poke(digits, digit, place + 1)
                poke(entries, target + place, key)
            source, target = target, source
            shift += width
    blocks = 0
    for i in range(start, stop):
        at = np.int64(peek(entries, source + i) & _U64(0xFFFFFFFF))
        reach = peek(entries, REACH * room + at)
        blocks += count_bits(reach)
        poke(entries, SORTED_REACH * room + i, reach)
        poke(entries, SORTED_SPLAT * room + i, peek(entries, SPLAT_KEY * room + at))
    return blocks


# ---------------------------------------------------------------------------------------------------------------------
# Blending a tile, forwards and backwards. A pixel that has stopped keeps minus its transmittance.


@_inline
def _open_tile(tile, grid, state, width):
    """Transmittance 1 in the image's pixels, -1 outside, zeros behind; returns the blocks with pixels as bits."""
    tiles_x, zero = grid[TILES_X], spread(F(0.0))
    alive = 0
    for offset in range(0, width * grid[TILE_BLOCKS], LANES):
        store(state, offset, zero)
    for block in range(grid[TILE_BLOCKS]):
        x = TILE * (tile % tiles_x) + 4 * (block & 7)
        y = TILE * (tile // tiles_x) + 4 * (block >> 3)
        if x < grid[WIDTH] and y < grid[HEIGHT]:
            alive |= 1 << block
        inside = (lane_x() < F(grid[WIDTH] - x)) & (lane_y() < F(grid[HEIGHT] - y))
        store(state, width * block, sel(inside, F(1.0), F(-1.0)))
    return alive


@_inline
def _fetch_ahead(entries, entry, stop, records):
    """Bring the record of a later entry near: its place is random, so no hardware prefetcher sees it coming."""
    later = peek(entries, SORTED_SPLAT * entries.shape[1] + min(entry + 6, stop - 1))
    prefetch(records, RECORD * np.int64(later & _U64(0xFFFFFFFF)))


@_inline
def _stopped(transmittance):
    """Minus its size: how a pixel that has stopped remembers what was left."""
    return float_bits(int_bits(transmittance) | np.int32(-0x80000000))


@_inline
def _place(records, base, block, along, across):
    """t and s at the 16 pixels of a block."""
    bx, by = peek(_BLOCK_X, block), peek(_BLOCK_Y, block)
    t = fma(spread(peek(records, base + L00)), bx, fma(spread(peek(records, base + L01)), by, along))
    return t, fma(spread(peek(records, base + L11)), by, across)


@_inline
def _alpha(records, base, block, along, across, view):
    """Alpha (0 below 1/255) at the 16 pixels of a block."""
    t, s = _place(records, base, block, along, across)
    power = fma(neg(s), s, fma(neg(t), t, peek(records, base + LOG_OPACITY)))
    alpha = _least(_exp2_hot(power, view), spread(peek(view, MAX_ALPHA)))
    return sel(power >= peek(view, LEAST_POWER), alpha, F(0.0))


# State of a block while blending, in floats: transmittance, depth (, red, green, blue), and room for the backward pass:
# transmittance, rest, gradient by red, green, blue, depth, alpha.
_SCORING, _COLORED = 32, 112


@_inline
def _splat(records, base, x, y):
    """t and s of a Gaussian at the pixels of the block at (x, y); further blocks are steps from there."""
    dx, dy = lane_x() - (peek(records, base + U) - x), lane_y() - (peek(records, base + V) - y)
    along = fma(dx, peek(records, base + L00), dy * peek(records, base + L01))
    return along, dy * peek(records, base + L11)


def _make_forward(with_color):
    """The forward loop over the entries of a tile; scoring candidates leaves colour out, and what backward needs."""
    width = _COLORED if with_color else _SCORING

    @_inner
    def forward(x, y, start, stop, alive, entries, records, view, state, kept, keeps):
        """Blend into ``state``. Returns the first entry that found all pixels stopped.

        With colour, the alphas that count (0 where a pixel has stopped) go to ``kept`` every ``keeps`` floats, and the
        blocks that were still open replace the entries' reach: the backward loop takes the same way.
        """
        room, at_kept = entries.shape[1], 0
        for entry in range(start, stop):
            if alive == 0:
                return entry
            _fetch_ahead(entries, entry, stop, records)
            reach = np.int64(peek(entries, SORTED_REACH * room + entry)) & alive
            if with_color:
                poke(entries, SORTED_REACH * room + entry, _U64(reach))
            if reach == 0:
                continue
            base = RECORD * np.int64(peek(entries, SORTED_SPLAT * room + entry) & _U64(0xFFFFFFFF))
            along, across = _splat(records, base, x, y)
            z = spread(peek(records, base + DEPTH))
            r, g, b = (
                spread(peek(records, base + RED)), spread(peek(records, base + GREEN)),
                spread(peek(records, base + BLUE)),
            )  # fmt: skip
            while reach != 0:
                block = lowest_bit(reach)
                reach &= reach - 1
                at = width * block
                opaque = _alpha(records, base, block, along, across, view)
                before = load(state, at)
                after = fma(neg(opaque), before, before)
                goes_on = after > peek(view, LEAST_LEFT)
                opaque = sel(goes_on, opaque, F(0.0))
                weight = opaque * before
                # With colour a branch hides the latency of this test from the next Gaussian on the block; without
                # colour (small, saturated pictures) its mispredictions cost more. Both measured.
                if not with_color or bits(goes_on) != 0xFFFF:
                    after = sel(goes_on, after, _stopped(before))
                    if bits(goes_on) == 0:
                        alive &= ~(1 << block)
                store(state, at, after)
                store(state, at + 16, fma(weight, z, load(state, at + 16)))
                if with_color:
                    store(state, at + 32, fma(weight, r, load(state, at + 32)))
                    store(state, at + 48, fma(weight, g, load(state, at + 48)))
                    store(state, at + 64, fma(weight, b, load(state, at + 64)))
                    store(kept, at_kept, opaque)
                    prefetch(kept, at_kept + 16 * LANES)  # to be written: a line costs more than the block if it is far
                    at_kept += keeps
        return stop

    return forward


_forward = _make_forward(True)
_forward_without_color = _make_forward(False)


@_inner
def _find_again(reach, records, base, along, across, view, state, kept):
    """The alphas of one entry that `_forward` had no room to keep."""
    at_kept = 0
    while reach != 0:
        block = lowest_bit(reach)
        reach &= reach - 1
        opaque = _alpha(records, base, block, along, across, view)
        before = load(state, _COLORED * block)
        goes_on = fma(neg(opaque), before, before) > peek(view, LEAST_LEFT)
        store(kept, at_kept, sel(goes_on, opaque, F(0.0)))
        at_kept += LANES
        before = before + F(0.0)
        store(state, _COLORED * block, sel(goes_on, before, _stopped(before)))


@_inner
def _backward(x, y, start, done, stop, entries, records, view, state, kept, keeps, slots):
    """Front to back: the rest R = C.gC + D gD + A gA loses each Gaussian's share as it passes (no division, no order
    reversal), and v = alpha dL/dalpha = w s - alpha / (1 - alpha) R with s = c.gC + z gD + gA.
    """
    room, zero, at_kept = entries.shape[1], spread(F(0.0)), 0
    for entry in range(start, done):
        _fetch_ahead(entries, entry, done, records)
        packed = peek(entries, SORTED_SPLAT * room + entry)
        slot = LANES * np.int64(packed >> _U64(32))
        reach = np.int64(peek(entries, SORTED_REACH * room + entry))
        if reach == 0:
            store(slots, slot, zero)
            continue
        base = RECORD * np.int64(packed & _U64(0xFFFFFFFF))
        along, across = _splat(records, base, x, y)
        if keeps == 0:
            at_kept = 0
            _find_again(reach, records, base, along, across, view, state, kept)
        r, g, b, z = (
            spread(peek(records, base + RED)), spread(peek(records, base + GREEN)),
            spread(peek(records, base + BLUE)), spread(peek(records, base + DEPTH)),
        )  # fmt: skip
        m0, m1, m2, m3, m4, m5 = zero, zero, zero, zero, zero, zero
        w_r, w_g, w_b, w_z, w_all = zero, zero, zero, zero, zero
        while reach != 0:
            block = lowest_bit(reach)
            reach &= reach - 1
            at = _COLORED * block
            t, s = _place(records, base, block, along, across)
            opaque = load(kept, at_kept)
            prefetch(kept, at_kept + 32 * LANES)  # what `blend` has kept of a whole picture comes from far
            at_kept += LANES
            before = load(state, at)
            weight = opaque * before
            store(state, at, before - weight)
            g_r, g_g, g_b = load(state, at + 32), load(state, at + 48), load(state, at + 64)
            g_z = load(state, at + 80)
            term = weight * fma(r, g_r, fma(g, g_g, fma(b, g_b, fma(z, g_z, load(state, at + 96)))))
            rest = load(state, at + 16) - term
            store(state, at + 16, rest)
            w_r, w_g, w_b = fma(weight, g_r, w_r), fma(weight, g_g, w_g), fma(weight, g_b, w_b)
            w_z, w_all = fma(weight, g_z, w_z), w_all + weight
            v = term - opaque / (peek(view, ONE) - opaque) * rest
            v = sel(opaque < peek(view, MAX_ALPHA), v, F(0.0))  # at its limit alpha does not move
            vt, vs = v * t, v * s
            m0, m1, m2 = m0 + v, m1 + vt, m2 + vs
            m3, m4, m5 = fma(vt, t, m3), fma(vt, s, m4), fma(vs, s, m5)
        store(slots, slot, sums((m0, m1, m2, m3, m4, m5, w_r, w_g, w_b, w_z, w_all)))
    for entry in range(done, stop):
        store(slots, LANES * np.int64(peek(entries, SORTED_SPLAT * room + entry) >> _U64(32)), zero)


@_inline
def _corner(tile, grid):
    return TILE * (tile % grid[TILES_X]), TILE * (tile // grid[TILES_X])


@_inner
def _write_tile(tile, grid, state, width, color, depth, alpha):
    """From the blocks to the pictures (no colour where ``width`` is that of scoring)."""
    x, y = _corner(tile, grid)
    for block in range(grid[TILE_BLOCKS]):
        left, top, at = x + 4 * (block & 7), y + 4 * (block >> 3), width * block
        pixel, place = top * grid[WIDTH] + left, top * grid[STRIDE] + grid[MARGIN] + 3 * left
        if left + 4 <= grid[WIDTH] and top + 4 <= grid[HEIGHT]:
            rest = load(state, at)
            store_block(alpha, pixel, grid[WIDTH], F(1.0) - _most(rest, neg(rest)))
            store_block(depth, pixel, grid[WIDTH], load(state, at + 16))
            if width != _SCORING:
                r, g, b = load(state, at + 32), load(state, at + 48), load(state, at + 64)
                store_color_block(color, place, grid[STRIDE], r, g, b)
            continue
        for row in range(min(4, grid[HEIGHT] - top)):
            for column in range(min(4, grid[WIDTH] - left)):
                lane = at + 4 * row + column
                poke(alpha, pixel + row * grid[WIDTH] + column, F(1.0) - abs(peek(state, lane)))
                poke(depth, pixel + row * grid[WIDTH] + column, peek(state, lane + 16))
                if width != _SCORING:
                    for channel in range(3):
                        value = peek(state, lane + 32 + 16 * channel)
                        poke(color, place + row * grid[STRIDE] + 3 * column + channel, value)


@_inner
def _read_tile(tile, grid, state, color, depth, alpha, by_color, by_depth, by_alpha, by_layout):
    """The state of the backward loop from the pictures and the gradients by them."""
    x, y = _corner(tile, grid)
    _open_tile(tile, grid, state, np.int64(_COLORED))
    for block in range(grid[TILE_BLOCKS]):
        left, top, at = x + 4 * (block & 7), y + 4 * (block >> 3), _COLORED * block
        pixel, place = top * grid[WIDTH] + left, top * grid[STRIDE] + grid[MARGIN] + 3 * left
        if left + 4 <= grid[WIDTH] and top + 4 <= grid[HEIGHT]:
            g_z, g_a = load_block(by_depth, pixel, grid[WIDTH]), load_block(by_alpha, pixel, grid[WIDTH])
            rest = load_block(depth, pixel, grid[WIDTH]) * g_z + load_block(alpha, pixel, grid[WIDTH]) * g_a
            g_r, g_g, g_b = load_color_block(by_color, top * by_layout[0] + by_layout[1] + 3 * left, by_layout[0])
            r, g, b = load_color_block(color, place, grid[STRIDE])
            store(state, at + 16, fma(r, g_r, fma(g, g_g, fma(b, g_b, rest))))
            store(state, at + 32, g_r)
            store(state, at + 48, g_g)
            store(state, at + 64, g_b)
            store(state, at + 80, g_z)
            store(state, at + 96, g_a)
            continue
        for row in range(min(4, grid[HEIGHT] - top)):
            for column in range(min(4, grid[WIDTH] - left)):
                lane, here = at + 4 * row + column, pixel + row * grid[WIDTH] + column
                rest_here = peek(depth, here) * peek(by_depth, here) + peek(alpha, here) * peek(by_alpha, here)
                poke(state, lane + 80, peek(by_depth, here))
                poke(state, lane + 96, peek(by_alpha, here))
                for channel in range(3):
                    spot = (top + row) * by_layout[0] + by_layout[1] + 3 * (left + column) + channel
                    by_channel = peek(by_color, spot)
                    rest_here += by_channel * peek(color, place + row * grid[STRIDE] + 3 * column + channel)
                    poke(state, lane + 32 + 16 * channel, by_channel)
                poke(state, lane + 16, rest_here)


# Factors of the losses: of |colour difference|, of SSIM, of |depth error|, twice that of (1 - alpha)^2; the alpha from
# which the depth of a pixel is compared, 1 for depth / alpha or 0 for depth itself, and 1 to compare colour everywhere
# or 0 for only where depth is compared.
OF_COLOR, OF_SSIM, OF_DEPTH, OF_ALPHA, LEAST_ALPHA, NORMALISED, EVERYWHERE, FACTORS = range(8)
# terms of a tile, 16 lanes each: sums of |colour difference| and of |depth error|, how many pixels were compared
TILE_COLOR, TILE_DEPTH, TILE_COMPARED, TILE_TERMS = 0, LANES, 2 * LANES, 3 * LANES


@_inline
def _difference(value, target, weight):
    """|value - target| and its derivative times ``weight``."""
    difference = value - target
    return _most(difference, neg(difference)), sel(
        difference > F(0.0), weight, sel(difference < F(0.0), neg(weight), F(0.0))
    )


@_inner
def _compare_tile(tile, grid, state, factors, target, target_depth, terms, edge):
    """Turn the state the forward loop leaves into the one the backward loop starts from, by the pixelwise losses.

    ``target [H * W * 3]`` and ``target_depth [H * W]`` without margins. ``edge [64]``: room for a block.
    """
    x, y = _corner(tile, grid)
    width, one = grid[WIDTH], spread(F(1.0))
    color_sum, depth_sum, compared = spread(F(0.0)), spread(F(0.0)), spread(F(0.0))
    for block in range(grid[TILE_BLOCKS]):
        left, top, at = x + 4 * (block & 7), y + 4 * (block >> 3), _COLORED * block
        if left >= width or top >= grid[HEIGHT]:
            continue
        pixel = top * width + left
        if left + 4 <= width and top + 4 <= grid[HEIGHT]:
            red, green, blue = load_color_block(target, 3 * pixel, 3 * width)
            measured = load_block(target_depth, pixel, width)
        else:
            for k in range(0, 64, LANES):
                store(edge, k, spread(F(0.0)))
            for row in range(min(4, grid[HEIGHT] - top)):
                for column in range(min(4, width - left)):
                    here = pixel + row * width + column
                    for channel in range(3):
                        poke(edge, 12 * row + 3 * column + channel, peek(target, 3 * here + channel))
                    poke(edge, 48 + 4 * row + column, peek(target_depth, here))
            red, green, blue = load_color_block(edge, 0, 12)
            measured = load(edge, 48)
        rest, z = load(state, at), load(state, at + 16)
        r, g, b = load(state, at + 32), load(state, at + 48), load(state, at + 64)
        left_over = _most(rest, neg(rest))
        opaque = one - left_over
        has_depth = measured > F(0.0)
        counts = has_depth & (opaque > factors[LEAST_ALPHA])
        # Outside the image colours and targets are 0, and so is everything that follows from them.
        colored = sel(counts, one, spread(factors[EVERYWHERE]))
        of_color = colored * factors[OF_COLOR]
        error_r, g_r = _difference(r, red, of_color)
        error_g, g_g = _difference(g, green, of_color)
        error_b, g_b = _difference(b, blue, of_color)
        error = error_r + error_g + error_b
        color_sum = fma(error, colored, color_sum)
        share = sel(counts & (spread(factors[NORMALISED]) > F(0.0)), opaque, F(1.0))
        expected = z / share
        error, g_z = _difference(expected, measured, spread(factors[OF_DEPTH]))
        depth_sum = depth_sum + sel(counts, error, F(0.0))
        compared = compared + sel(counts, one, F(0.0))
        g_z = sel(counts, g_z / share, F(0.0))
        g_a = neg(sel(has_depth, left_over * factors[OF_ALPHA], F(0.0)))
        g_a = g_a - g_z * expected * factors[NORMALISED]
        total = fma(r, g_r, fma(g, g_g, fma(b, g_b, fma(z, g_z, opaque * g_a))))
        store(state, at, sel(rest > F(-1.0), one, neg(one)))  # -1 stays what it was: no pixel to look at
        store(state, at + 16, total)
        store(state, at + 32, g_r)
        store(state, at + 48, g_g)
        store(state, at + 64, g_b)
        store(state, at + 80, g_z)
        store(state, at + 96, g_a)
    store(terms, TILE_TERMS * tile + TILE_COLOR, color_sum)
    store(terms, TILE_TERMS * tile + TILE_DEPTH, depth_sum)
    store(terms, TILE_TERMS * tile + TILE_COMPARED, compared)


# ---------------------------------------------------------------------------------------------------------------------
# From the slots back to the parameters.


@_inline
def _add_outer(pose, seen, a0, a1, a2, b0, b1, b2):
    """pose[3 j + k] += a_j b_k in the lanes that count."""
    a0, a1, a2 = sel(seen, a0, F(0.0)), sel(seen, a1, F(0.0)), sel(seen, a2, F(0.0))
    b0, b1, b2 = sel(seen, b0, F(0.0)), sel(seen, b1, F(0.0)), sel(seen, b2, F(0.0))
    store(pose, 0, fma(a0, b0, load(pose, 0)))
    store(pose, LANES, fma(a0, b1, load(pose, LANES)))
    store(pose, LANES * 2, fma(a0, b2, load(pose, LANES * 2)))
    store(pose, LANES * 3, fma(a1, b0, load(pose, LANES * 3)))
    store(pose, LANES * 4, fma(a1, b1, load(pose, LANES * 4)))
    store(pose, LANES * 5, fma(a1, b2, load(pose, LANES * 5)))
    store(pose, LANES * 6, fma(a2, b0, load(pose, LANES * 6)))
    store(pose, LANES * 7, fma(a2, b1, load(pose, LANES * 7)))
    store(pose, LANES * 8, fma(a2, b2, load(pose, LANES * 8)))


@_inline
def _axis_gradient(axis, scale, row, covariance, lens, view, seen, gradient, pose):
    """One axis of the Gaussian: writes the derivative by its log-scale, adds to the pose's, returns the derivatives by
    the axis' direction (3) and by J00, J02, J11, J12.
    """
    s00, s01, s11 = covariance
    j00, j02, j11, j12 = lens
    k0, k1, k2 = axis[0] * scale, axis[1] * scale, axis[2] * scale
    t0 = _dot3(k0, k1, k2, spread(view[0]), spread(view[1]), spread(view[2]))  # turned into the camera
    t1 = _dot3(k0, k1, k2, spread(view[4]), spread(view[5]), spread(view[6]))
    t2 = _dot3(k0, k1, k2, spread(view[8]), spread(view[9]), spread(view[10]))
    b0, b1 = fma(j02, t2, j00 * t0), fma(j12, t2, j11 * t1)
    by_b0, by_b1 = fma(s01, b1, s00 * b0) * F(2.0), fma(s11, b1, s01 * b0) * F(2.0)
    by_t0, by_t1, by_t2 = j00 * by_b0, j11 * by_b1, fma(j12, by_b1, j02 * by_b0)
    _add_outer(pose, seen, by_t0, by_t1, by_t2, k0, k1, k2)
    d0 = fma(by_t2, view[8], fma(by_t1, view[4], by_t0 * view[0]))
    d1 = fma(by_t2, view[9], fma(by_t1, view[5], by_t0 * view[1]))
    d2 = fma(by_t2, view[10], fma(by_t1, view[6], by_t0 * view[2]))
    store(gradient, LANES * row, _dot3(k0, k1, k2, d0, d1, d2))
    return d0 * scale, d1 * scale, d2 * scale, by_b0 * t0, by_b0 * t2, by_b1 * t1, by_b1 * t2


@_inline
def _splat_gradient(parameters, i, view, grid, records, sums_of, gradient, pose):
    """Derivatives of Gaussians i .. i + 15: into ``gradient [14 * 16]`` and, summed up, into ``pose [12 * 16]``.

    ``sums_of [16 * 16]`` holds the sums of every Gaussian (zero for those without any). Returns which had a weight.
    """
    capacity = grid[CAPACITY]
    m = load_sums(sums_of, 0)
    seen = m[W_ALL] > F(0.0)
    if bits(seen) == 0:
        return np.int64(0)
    record = load_transposed(records, RECORD * i)
    l00, l01, l11 = sel(seen, record[L00], F(0.0)), sel(seen, record[L01], F(0.0)), sel(seen, record[L11], F(0.0))
    by_u, by_v = l00 * m[VT] * LN_4, fma(l01, m[VT], l11 * m[VS]) * LN_4
    half = F(0.5) * LN_4 * LN_4
    first, second = fma(l01, m[VTT], l11 * m[VTS]), fma(l01, m[VTS], l11 * m[VSS])
    s00, s01, s11 = l00 * l00 * m[VTT] * half, l00 * first * half, fma(l01, first, l11 * second) * half

    x, y, z = _camera_point(parameters, capacity, i, view)
    z = _most(z, spread(NEAR_PLANE))
    inverse_z = spread(F(1.0)) / z
    j00, j02, j11, j12, slope_x, slope_y = _jacobian(x, y, inverse_z, view)
    (q0, q1, q2, q3), inverse_length, r = _rotation(parameters, capacity, i)
    s0 = _scale(parameters, capacity, i, np.int64(0))
    s1 = _scale(parameters, capacity, i, np.int64(1))
    s2 = _scale(parameters, capacity, i, np.int64(2))
    covariance, lens = (s00, s01, s11), (j00, j02, j11, j12)
    h0, h3, h6, x00, x02, x11, x12 = _axis_gradient(
        (r[0], r[3], r[6]), s0, np.int64(7), covariance, lens, view, seen, gradient, pose
    )
    h1, h4, h7, y00, y02, y11, y12 = _axis_gradient(
        (r[1], r[4], r[7]), s1, np.int64(8), covariance, lens, view, seen, gradient, pose
    )
    h2, h5, h8, z00, z02, z11, z12 = _axis_gradient(
        (r[2], r[5], r[8]), s2, np.int64(9), covariance, lens, view, seen, gradient, pose
    )
    by_j00, by_j02, by_j11, by_j12 = x00 + y00 + z00, x02 + y02 + z02, x11 + y11 + z11, x12 + y12 + z12
    h = (h0, h1, h2, h3, h4, h5, h6, h7, h8)
    g0 = fma(q1, h[7] - h[5], fma(q2, h[2] - h[6], q3 * (h[3] - h[1])))
    g1 = fma(q2, h[3] + h[1], fma(q3, h[6] + h[2], fma(q0, h[7] - h[5], q1 * (h[4] + h[8]) * F(-2.0))))
    g2 = fma(q1, h[3] + h[1], fma(q3, h[7] + h[5], fma(q0, h[2] - h[6], q2 * (h[0] + h[8]) * F(-2.0))))
    g3 = fma(q1, h[6] + h[2], fma(q2, h[7] + h[5], fma(q0, h[3] - h[1], q3 * (h[0] + h[4]) * F(-2.0))))
    along = fma(q0, g0, fma(q1, g1, fma(q2, g2, q3 * g3)))
    twice = inverse_length + inverse_length
    store(gradient, LANES * 3, (g0 - q0 * along) * twice)
    store(gradient, LANES * 4, (g1 - q1 * along) * twice)
    store(gradient, LANES * 5, (g2 - q2 * along) * twice)
    store(gradient, LANES * 6, (g3 - q3 * along) * twice)

    # The camera point: through the mean's pixel, the depth channel and the Jacobian.
    square = inverse_z * inverse_z
    f_x, f_y = square * view[FX], square * view[FY]
    inside_x = (x * inverse_z >= view[LOW_X]) & (x * inverse_z <= view[HIGH_X])
    inside_y = (y * inverse_z >= view[LOW_Y]) & (y * inverse_z <= view[HIGH_Y])
    moved_x, moved_y = sel(inside_x, f_x * by_j02, F(0.0)), sel(inside_y, f_y * by_j12, F(0.0))
    by_x, by_y = j00 * by_u - moved_x, j11 * by_v - moved_y
    by_z = m[W_DEPTH] - fma(f_x, fma(x, by_u, by_j00), f_y * fma(y, by_v, by_j11))
    # J02 = -fx clamp(x / z) / z: outside the clamp only its last factor moves.
    by_z = by_z + fma(slope_x, fma(f_x, by_j02, moved_x), slope_y * fma(f_y, by_j12, moved_y))
    mx, my, mz = load(parameters, i), load(parameters, capacity + i), load(parameters, 2 * capacity + i)
    _add_outer(pose, seen, by_x, by_y, by_z, mx, my, mz)
    store(pose, LANES * 9, load(pose, LANES * 9) + sel(seen, by_x, F(0.0)))
    store(pose, LANES * 10, load(pose, LANES * 10) + sel(seen, by_y, F(0.0)))
    store(pose, LANES * 11, load(pose, LANES * 11) + sel(seen, by_z, F(0.0)))
    store(gradient, 0, fma(by_z, view[8], fma(by_y, view[4], by_x * view[0])))
    store(gradient, LANES, fma(by_z, view[9], fma(by_y, view[5], by_x * view[1])))
    store(gradient, LANES * 2, fma(by_z, view[10], fma(by_y, view[6], by_x * view[2])))
    _, complement, _ = _opacity(parameters, capacity, i)
    store(gradient, LANES * 10, complement * m[V_])
    store(gradient, LANES * 11, m[W_RED])
    store(gradient, LANES * 12, m[W_GREEN])
    store(gradient, LANES * 13, m[W_BLUE])
    return bits(seen)


@_inner
def _step_chunk(
    chunk, parameters, first_moment, second_moment, rates, view, grid, records, visible, slots, gradient, pose_parts,
    scratch,
):
    """Gather the slots of 1024 Gaussians and step them (Adam), write their dense gradient, or only the pose's.

    ``scratch [42 * 16]``: gathered sums, gradient, pose.
    """
    capacity, zero = grid[CAPACITY], spread(F(0.0))
    sums_of, own, pose = scratch[: 16 * LANES], scratch[16 * LANES : 30 * LANES], scratch[30 * LANES :]
    for k in range(12):
        store(pose, LANES * k, zero)
    beta1, beta2, epsilon, stepping = rates[BETA1], rates[BETA2], rates[EPSILON], rates[MODE] > F(0.0)
    end = min((chunk + 1) * CHUNK, grid[COUNT])
    for i in range(chunk * CHUNK, end, LANES):
        seen = np.int64(peek(visible, i // LANES))
        if seen == 0:
            continue
        later = min(i + LANES, end - 1)
        if peek(visible, later // LANES) != 0:
            for row in range(ROWS):  # too many streams for the hardware prefetcher
                prefetch(parameters, row * capacity + later)
                if stepping:
                    prefetch(first_moment, row * capacity + later)
                    prefetch(second_moment, row * capacity + later)
        for lane in range(LANES):
            total = zero
            if (seen >> lane) & 1:
                base = RECORD * (i + lane)
                slot = peek_bits(records, base + SLOT)
                for at in range(slot, slot + peek_bits(records, base + SLOTS)):
                    total = total + load(slots, LANES * at)
            store(sums_of, LANES * lane, total)
        seen = _splat_gradient(parameters, i, view, grid, records, sums_of, own, pose)
        if seen == 0 or rates[MODE] < F(0.0):
            continue
        if rates[ISOTROPIC] > F(0.0):
            together = load(own, LANES * 7) + load(own, LANES * 8) + load(own, LANES * 9)
            store(own, LANES * 7, together)
            store(own, LANES * 8, together)
            store(own, LANES * 9, together)
        mask = load_sums(sums_of, 0)[W_ALL] > F(0.0)
        for row in range(ROWS):
            g = sel(mask, load(own, LANES * row), F(0.0))
            at = row * capacity + i
            if not stepping:
                store(gradient, at, g)
                continue
            # Differences are masked, not results: a select before a store becomes a slow masked store.
            m, s = load(first_moment, at), load(second_moment, at)
            m = m + sel(mask, (g - m) * (F(1.0) - beta1), F(0.0))
            s = s + sel(mask, (g * g - s) * (F(1.0) - beta2), F(0.0))
            store(first_moment, at, m)
            store(second_moment, at, s)
            step = m / (sqrt(s) + epsilon) * rates[row]
            store(parameters, at, load(parameters, at) - sel(mask, step, F(0.0)))
    store(
        pose_parts, LANES * chunk,
        sums((
            load(pose, 0), load(pose, 16), load(pose, 32), load(pose, 48), load(pose, 64), load(pose, 80),
            load(pose, 96), load(pose, 112), load(pose, 128), load(pose, 144), load(pose, 160), load(pose, 176),
        )),
    )  # fmt: skip


# results: the derivative by camera_from_world [3, 4], then the sums of the terms of all tiles
OF_POSE, RESULTS = 12, 15
_POSE_LANES = np.array([[SUM_LANES.index(x) for x in (3 * j, 3 * j + 1, 3 * j + 2, 9 + j)] for j in range(3)]).ravel()


@_inner
def _sum_up(grid, pose_parts, terms, results):
    """From the parts of every chunk and tile to ``results [15]``, in float64 and always in the same order."""
    for number in range(OF_POSE):
        total = 0.0
        for chunk in range(grid[CHUNKS]):
            total += peek(pose_parts, LANES * chunk + peek(_POSE_LANES, number))
        poke(results, number, total)
    if len(terms) == 0:
        return
    for number in range(3):
        total = 0.0
        for tile in range(grid[TILES_X] * grid[TILES_Y]):
            for lane in range(LANES):
                total += peek(terms, TILE_TERMS * tile + LANES * number + lane)
        poke(results, OF_POSE + number, total)


@_inner
def _step(
    tickets, parameters, first_moment, second_moment, rates, view, grid, records, visible, slots, gradient, pose_parts,
    terms, results, scratch,
):
    """When the slots of all tiles are there: `_step_chunk` for every chunk. The last to finish sums up the parts."""
    if not _all_done(tickets, TILES_DONE, grid[TILES_X] * grid[TILES_Y]):
        return
    while True:
        chunk = take_ticket(tickets, 6)
        if chunk >= grid[CHUNKS]:
            return
        _step_chunk(
            chunk, parameters, first_moment, second_moment, rates, view, grid, records, visible, slots, gradient,
            pose_parts, scratch,
        )  # fmt: skip
        if take_ticket(tickets, STEPPED) == grid[CHUNKS] - 1:
            _sum_up(grid, pose_parts, terms, results)


# ---------------------------------------------------------------------------------------------------------------------
# Losses. Colour images here are rows of STRIDE floats: MARGIN zeros, the pixels interleaved, zeros; the blur of one
# channel is then a blur with steps of three floats.
#
# A thread takes a strip of the picture, some vectors wide and all rows high, and goes down it in groups of 8 rows. Of
# every group it blurs along the rows, then down the columns where the group and its neighbours are there, so that one
# load of a row serves up to 8 sums. What it carries from group to group stays in the second cache:
#     lines   u = (x + y) / sqrt(2), v = (x - y) / sqrt(2) of one row
#     means   3 groups [column, (u, u^2, v, v^2), row, 16] blurred along the rows
#     maps    1 group [(mean, variance, covariance), row, column, 16] of the derivatives of SSIM
#     backs   3 groups [column, (mean, variance, covariance), row, 16] of these, blurred along the rows
# With u and v two blurred squares take the part of x^2 + y^2 and of x y, and no product has to be stored.

_HALF_TAPS = np.exp(-0.5 * (np.arange(-5, 6) / 1.5) ** 2)
_TAPS = (_HALF_TAPS / _HALF_TAPS.sum()).astype(np.float32)
_C1, _C2, _ROOT = F(0.01**2), F(0.03**2), F(np.sqrt(0.5))
_GROUP = 8
_BLOCK = _GROUP * LANES  # floats of one quantity of a group in one column
# terms of a column of vectors, 16 lanes each: sums of |colour difference| and SSIM; then of pieces of the depth image,
# so many pixels each: the sum of |depth error|
TERM_COLOR, TERM_SSIM, TERMS = 0, LANES, 2 * LANES
PIECE = 1920
STRIP_FLOATS = (3 * 4 + 3 * 3 + 3) * _BLOCK + 2 * LANES  # of scratch per column of a strip and its 4 columns of edge


def _load_at(context, builder, sig, args, offset):
    pointer = _pointer(context, builder, sig.args[0], args[0], builder.add(args[1], ir.Constant(_I64, offset)))
    return builder.load(builder.bitcast(pointer, _FLOATS.as_pointer()), align=4, typ=_FLOATS)


def _taps(builder):
    """By distance, one value for all uses: literal vectors would be most of the code that LLVM has to read."""
    return [_spread(builder, ir.Constant(_F32, float(tap))) for tap in _TAPS[5:]]


def _fused(builder, a, b, c):
    return _call(builder, "llvm.fmuladd.v16f32", _FLOATS, [a, b, c])


@intrinsic
def _blur_along(typingctx, array, index):
    """Horizontal blur at 16 floats."""

    def codegen(context, builder, sig, args):
        taps = _taps(builder)
        total = builder.fmul(_load_at(context, builder, sig, args, 0), taps[0])
        for k in range(1, 6):
            pair = [_load_at(context, builder, sig, args, offset) for offset in (-3 * k, 3 * k)]
            total = _fused(builder, builder.fadd(*pair), taps[k], total)
        return total

    return floats(array, types.intp), codegen


@intrinsic
def _blur_squares_along(typingctx, array, index):
    """Horizontal blur at 16 floats, of the values and of their squares."""

    def codegen(context, builder, sig, args):
        taps, value = _taps(builder), _load_at(context, builder, sig, args, 0)
        total, squares = builder.fmul(value, taps[0]), builder.fmul(builder.fmul(value, value), taps[0])
        for k in range(1, 6):
            one, two = (_load_at(context, builder, sig, args, offset) for offset in (-3 * k, 3 * k))
            total = _fused(builder, builder.fadd(one, two), taps[k], total)
            squares = _fused(builder, _fused(builder, one, one, builder.fmul(two, two)), taps[k], squares)
        return context.make_tuple(builder, sig.return_type, [total, squares])

    return types.UniTuple(floats, 2)(array, types.intp), codegen


@intrinsic
def _blur_down(typingctx, array, above, here, below, to):
    """Vertical blur of a group of 8 rows, from the blocks of itself and its neighbours to the one at ``to``."""

    def codegen(context, builder, sig, args):
        taps, totals = _taps(builder), [None] * _GROUP
        for row in range(-5, _GROUP + 5):
            block = [args[0], args[2 + (row >= _GROUP) - (row < 0)]]
            value = _load_at(context, builder, sig, block, LANES * (row % _GROUP))
            for to in range(max(row - 5, 0), min(row + 6, _GROUP)):
                tap = taps[abs(row - to)]
                totals[to] = builder.fmul(value, tap) if row == to - 5 else _fused(builder, value, tap, totals[to])
        for row, total in enumerate(totals):
            at = builder.add(args[4], ir.Constant(_I64, LANES * row))
            pointer = _pointer(context, builder, sig.args[0], args[0], at)
            builder.store(total, builder.bitcast(pointer, _FLOATS.as_pointer()), align=4)
        return context.get_dummy_value()

    return types.void(array, *[types.intp] * 4), codegen


def _first_lanes(builder, count):
    lanes = ir.Constant(_INTS, list(range(LANES)))
    return builder.icmp_signed("<", lanes, _spread(builder, builder.trunc(count, _I32)))


@intrinsic
def _load_first(typingctx, array, index, count):
    """The first ``count`` of 16 floats and zeros; what lies behind is not touched."""

    def codegen(context, builder, sig, args):
        pointer = builder.bitcast(_pointer(context, builder, sig.args[0], args[0], args[1]), _FLOATS.as_pointer())
        mask = _first_lanes(builder, args[2])
        kind = ir.FunctionType(_FLOATS, [pointer.type, _I32, _MASK, _FLOATS])
        function = cgutils.get_or_insert_function(builder.module, kind, "llvm.masked.load.v16f32.p0")
        return builder.call(function, [pointer, ir.Constant(_I32, 4), mask, ir.Constant(_FLOATS, None)])

    return floats(array, types.intp, types.intp), codegen


@intrinsic
def _store_first(typingctx, array, index, count, value):
    def codegen(context, builder, sig, args):
        pointer = builder.bitcast(_pointer(context, builder, sig.args[0], args[0], args[1]), _FLOATS.as_pointer())
        kind = ir.FunctionType(ir.VoidType(), [_FLOATS, pointer.type, _I32, _MASK])
        function = cgutils.get_or_insert_function(builder.module, kind, "llvm.masked.store.v16f32.p0")
        builder.call(function, [args[3], pointer, ir.Constant(_I32, 4), _first_lanes(builder, args[2])])
        return context.get_dummy_value()

    return types.void(array, types.intp, types.intp, floats), codegen


@_inline
def _load_up_to(array, at, end):
    """16 floats, zeros from ``end`` on."""
    return load(array, at) if at + LANES <= end else _load_first(array, at, end - at)


@_inline
def _store_up_to(array, at, end, value):
    if at + LANES <= end:
        store(array, at, value)
    else:
        _store_first(array, at, end - at, value)


@_inline
def _load_target(target, row, column, length):
    """16 floats of a row of ``target [H, length]``, zeros behind its end."""
    return _load_up_to(target, row * length + LANES * column, (row + 1) * length)


@_inner
def _clear(array, first, end):
    for at in range(first, end, LANES):
        store(array, at, spread(F(0.0)))


@_inner
def _means_of_group(top, first, last, grid, image, target, scratch, lines, means):
    """Blur along the rows from ``top`` on, from column ``first`` on."""
    stride, length, height = grid[STRIDE], 3 * grid[WIDTH], grid[HEIGHT]
    columns = (length + LANES - 1) // LANES
    room = last - first + 4
    low, high = max(first - 1, 0), min(last + 1, columns)
    for row in range(top, min(top + _GROUP, height)):
        base = row * stride + grid[MARGIN]
        for column in range(max(first - 2, 0), min(last + 2, columns)):
            x, y = load(image, base + LANES * column), _load_target(target, row, column, length)
            at = lines + LANES * (column - first + 2)
            store(scratch, at, (x + y) * _ROOT)
            store(scratch, at + LANES * room, (x - y) * _ROOT)
        for column in range(low, high):
            at = lines + LANES * (column - first + 2)
            mean_u, square_u = _blur_squares_along(scratch, at)
            mean_v, square_v = _blur_squares_along(scratch, at + LANES * room)
            to = means + 4 * _BLOCK * (column - first + 1) + LANES * (row - top)
            store(scratch, to, mean_u)
            store(scratch, to + _BLOCK, square_u)
            store(scratch, to + 2 * _BLOCK, mean_v)
            store(scratch, to + 3 * _BLOCK, square_v)
    for row in range(max(height - top, 0), _GROUP):
        for to in range(means + LANES * row, means + 4 * _BLOCK * (last - first + 2), _BLOCK):
            store(scratch, to, spread(F(0.0)))


@_inner
def _maps_of_group(top, first, last, grid, scratch, above, here, below, blurred, maps, backs, terms):
    """SSIM of the rows from ``top`` on: its sum, and its derivatives, blurred along the rows."""
    length, zero = 3 * grid[WIDTH], spread(F(0.0))
    line = LANES * (last - first + 2)  # of the maps: the columns of the strip and one at each side
    plane = _GROUP * line
    for column in range(max(first - 1, 0), last + 2):
        # The derivatives are blurred two columns later, row by row in turn with SSIM: its arithmetic and their loads
        # across cache lines go well together, and loads do not meet stores on their way.
        total = zero
        if column <= last:
            for own in range(0, 4 * _BLOCK, _BLOCK):
                at = 4 * _BLOCK * (column - first + 1) + own
                _blur_down(scratch, above + at, here + at, below + at, blurred + own)
        for row in range(_GROUP):
            at = maps + row * line + LANES * (column - first + 1)
            if column <= last:
                own = blurred + LANES * row
                mu, mv = load(scratch, own), load(scratch, own + 2 * _BLOCK)
                mu_mu, mv_mv = mu * mu, mv * mv
                var_u, var_v = load(scratch, own + _BLOCK) - mu_mu, load(scratch, own + 3 * _BLOCK) - mv_mv
                n1, n2 = mu_mu - mv_mv + _C1, var_u - var_v + _C2
                d1, d2 = mu_mu + mv_mv + _C1, var_u + var_v + _C2
                inverse = spread(F(1.0)) / (d1 * d2)
                value = n1 * n2 * inverse
                mx, my = mu + mv, mu - mv  # times sqrt(2)
                by_mean = fma(my, n2 - n1, mx * value * (d1 - d2)) * inverse * (F(2.0) * _ROOT)
                inside = lane_index() < F(length - LANES * column if top + row < grid[HEIGHT] else 0)
                total = total + sel(inside, value, F(0.0))
                store(scratch, at, sel(inside, by_mean, F(0.0)))
                store(scratch, at + plane, sel(inside, neg(value * d1 * inverse), F(0.0)))
                store(scratch, at + 2 * plane, sel(inside, n1 * inverse * F(2.0), F(0.0)))
            if column - 2 >= first:
                at, to = at - 2 * LANES, backs + 3 * _BLOCK * (column - 2 - first) + LANES * row
                store(scratch, to, _blur_along(scratch, at))
                store(scratch, to + _BLOCK, _blur_along(scratch, at + plane))
                store(scratch, to + 2 * _BLOCK, _blur_along(scratch, at + 2 * plane))
        if column >= first and column < last:
            at = TERMS * column + TERM_SSIM
            store(terms, at, load(terms, at) + total)


@_inner
def _gradient_of_group(
    top, first, last, grid, image, target, scratch, above, here, below, blurred, factors, by_color, terms
):
    """The derivative by the colours of the rows from ``top`` on, and the sum of their differences."""
    stride, length = grid[STRIDE], 3 * grid[WIDTH]
    of_sign, of_ssim = factors[OF_COLOR], factors[OF_SSIM]
    for column in range(first, last):
        for quantity in range(0, 3 * _BLOCK, _BLOCK):
            own = 3 * _BLOCK * (column - first) + quantity
            _blur_down(scratch, above + own, here + own, below + own, blurred + quantity)
        inside, total = lane_index() < F(length - LANES * column), spread(F(0.0))
        for row in range(top, min(top + _GROUP, grid[HEIGHT])):
            at, own = row * stride + grid[MARGIN] + LANES * column, blurred + LANES * (row - top)
            x, y = load(image, at), _load_target(target, row, column, length)
            error, gradient = _difference(x, y, spread(of_sign))
            total = total + error
            by_variance, by_covariance = load(scratch, own + _BLOCK), load(scratch, own + 2 * _BLOCK)
            of_both = fma(x + x, by_variance, fma(y, by_covariance, load(scratch, own)))
            store(by_color, at, sel(inside, fma(of_both, of_ssim, gradient), F(0.0)))
        at = TERMS * column + TERM_COLOR
        store(terms, at, load(terms, at) + total)  # both are 0 behind the row's end


@_inner
def _compare_depth(first, end, depth, alpha, target_depth, factors, by_depth, by_alpha):
    """Sum of the depth errors of pixels from ``first`` to before ``end``; the derivatives by depth and alpha."""
    total, one = spread(F(0.0)), spread(F(1.0))
    normalised = spread(factors[NORMALISED]) > F(0.0)
    for at in range(first, end, LANES):
        measured, opaque = _load_up_to(target_depth, at, end), _load_up_to(alpha, at, end)
        has_depth = measured > F(0.0)
        counts = has_depth & (opaque > factors[LEAST_ALPHA])
        of_sum = one / sel(counts & normalised, opaque, F(1.0))
        expected = _load_up_to(depth, at, end) * of_sum
        error, sign = _difference(expected, measured, spread(factors[OF_DEPTH]))
        total = total + sel(counts, error, F(0.0))
        g_z = sel(counts, sign * of_sum, F(0.0))
        _store_up_to(by_depth, at, end, g_z)
        g_a = sel(has_depth, (opaque - F(1.0)) * factors[OF_ALPHA], F(0.0))
        _store_up_to(by_alpha, at, end, g_a - g_z * expected * factors[NORMALISED])
    return total


# ---------------------------------------------------------------------------------------------------------------------
# Entry points: every thread calls the same one; tickets hand out the units of work.


@_entry
def prepare(
    tickets, parameters, view, grid, records, visible, histogram, chunk_entries, tile_start, tile_order, entries
):
    """Project, count and list. Without room for the entries it ends before listing and goes on when called again with
    more; FILLED counts up to the number of chunks.
    """
    chunks = grid[CHUNKS]
    while True:
        chunk = take_ticket(tickets, 0)
        if chunk >= chunks:
            break
        _project_chunk(chunk, parameters, view, grid, records, visible, histogram, chunk_entries)
        if take_ticket(tickets, PROJECTED) == chunks - 1:  # the last one to finish
            tickets[ENTRIES] = _plan(grid, histogram, chunk_entries, tile_start, tile_order)
            take_ticket(tickets, PLANNED)
    if not _all_done(tickets, PLANNED, 1) or tickets[ENTRIES] > entries.shape[1]:
        return
    while True:
        chunk = take_ticket(tickets, 1)
        if chunk >= chunks:
            return
        _fill_chunk(chunk, grid, records, visible, histogram, chunk_entries, entries)
        take_ticket(tickets, FILLED)


@_entry
def blend(
    tickets, view, grid, records, tile_start, tile_order, entries, scratch, kept, kept_at, color, depth, alpha
):
    """Sort, blend and write every tile.

    The alphas that `unblend` needs go to ``kept`` as far as its room goes. ``kept_at [2 * tiles]``: where those of a
    tile start (-1: not kept) and the first entry that found all of its pixels stopped.
    """
    own = LANES * take_ticket(tickets, THREAD_TICKET) * (SCRATCH // LANES)
    state, digits = scratch[own : own + SCRATCH], np.empty(DIGITS, np.int64)
    tiles = grid[TILES_X] * grid[TILES_Y]
    while True:
        ticket = take_ticket(tickets, 2)
        if ticket >= tiles:
            return
        tile = tile_order[ticket]
        start, stop = tile_start[tile], tile_start[tile + 1]
        blocks = _sort_tile(start, stop, entries, digits)
        place = LANES * take_tickets(tickets, KEPT_TICKET, blocks)
        keeps = LANES if place + LANES * blocks <= len(kept) else 0
        if keeps == 0:
            place = 0
        kept_at[2 * tile] = place if keeps != 0 else -1
        alive = _open_tile(tile, grid, state, np.int64(_COLORED))
        x, y = _corner(tile, grid)
        keep = kept[place:] if keeps != 0 else state[SCRATCH - LANES :]
        kept_at[2 * tile + 1] = _forward(F(x), F(y), start, stop, alive, entries, records, view, state, keep, keeps)
        _write_tile(tile, grid, state, np.int64(_COLORED), color, depth, alpha)


@_entry
def fuse(
    tickets, view, grid, records, tile_start, tile_order, entries, scratch, factors, target, target_depth, terms, slots,
    parameters, first_moment, second_moment, rates, visible, gradient, pose_parts, results,
):
    """Blend, compare with the target and go back, a tile at a time, all of it in the nearest caches; then step."""
    own = LANES * take_ticket(tickets, THREAD_TICKET) * (SCRATCH // LANES)
    state, kept = scratch[own : own + 64 * _COLORED], scratch[own + 64 * _COLORED : own + SCRATCH]
    digits, edge = np.empty(DIGITS, np.int64), np.empty(64, np.float32)
    while True:
        ticket = take_ticket(tickets, 2)
        if ticket >= grid[TILES_X] * grid[TILES_Y]:
            break
        tile = tile_order[ticket]
        start, stop = tile_start[tile], tile_start[tile + 1]
        blocks = _sort_tile(start, stop, entries, digits)
        keeps = LANES if LANES * blocks <= len(kept) else 0
        alive = _open_tile(tile, grid, state, np.int64(_COLORED))
        x, y = _corner(tile, grid)
        done = _forward(F(x), F(y), start, stop, alive, entries, records, view, state, kept, keeps)
        _compare_tile(tile, grid, state, factors, target, target_depth, terms, edge)
        _backward(F(x), F(y), start, done, stop, entries, records, view, state, kept, keeps, slots)
        take_ticket(tickets, TILES_DONE)
    _step(
        tickets, parameters, first_moment, second_moment, rates, view, grid, records, visible, slots, gradient,
        pose_parts, terms, results, scratch[own : own + SCRATCH],
    )  # fmt: skip


@_entry
def compare(
    tickets, strip, grid, image, depth, alpha, target, target_depth, scratch, factors, terms, by_color, by_depth,
    by_alpha,
):
    """Losses and gradient images: colour in strips of so many vectors, then depth in pieces.

    ``target [H * W * 3]`` without margins. The ``strip`` does not change the results.
    """
    own = LANES * take_ticket(tickets, THREAD_TICKET) * (SCRATCH // LANES)
    state, columns = scratch[own : own + SCRATCH], (3 * grid[WIDTH] + LANES - 1) // LANES
    means, backs = 4 * _BLOCK * (strip + 2), 3 * _BLOCK * strip  # floats of a group
    at_backs = 3 * means
    at_maps = at_backs + 3 * backs
    at_lines = at_maps + 3 * _BLOCK * (strip + 2)
    at_blurred = at_lines + 2 * LANES * (strip + 4)
    groups = (grid[HEIGHT] + _GROUP - 1) // _GROUP
    while True:
        first = strip * take_ticket(tickets, 3)
        if first >= columns:
            break
        last = min(first + strip, columns)
        _clear(state, 2 * means, 3 * means)  # what lies above the picture
        _clear(state, at_backs + 2 * backs, at_blurred)  # the same, and what lies at its sides
        _clear(terms, TERMS * first, TERMS * last)
        for step in range(groups + 2):
            # group g lies in place (g + 3) % 3
            newest, middle, oldest = step % 3, (step + 2) % 3, (step + 1) % 3
            if step <= groups:
                _means_of_group(_GROUP * step, first, last, grid, image, target, state, at_lines, means * newest)
            if step > groups:
                _clear(state, at_backs + backs * middle, at_backs + backs * (middle + 1))
            elif step >= 1:
                _maps_of_group(
                    _GROUP * (step - 1), first, last, grid, state, means * oldest, means * middle, means * newest,
                    at_blurred, at_maps, at_backs + backs * middle, terms,
                )  # fmt: skip
            if step >= 2:
                _gradient_of_group(
                    _GROUP * (step - 2), first, last, grid, image, target, state, at_backs + backs * newest,
                    at_backs + backs * oldest, at_backs + backs * middle, at_blurred, factors, by_color, terms,
                )  # fmt: skip
    pixels = grid[HEIGHT] * grid[WIDTH]
    while True:
        piece = take_ticket(tickets, 4)
        if PIECE * piece >= pixels:
            return
        end = min(PIECE * (piece + 1), pixels)
        error = _compare_depth(PIECE * piece, end, depth, alpha, target_depth, factors, by_depth, by_alpha)
        store(terms, TERMS * columns + LANES * piece, error)


@_entry
def unblend(
    tickets, view, grid, records, tile_start, tile_order, entries, scratch, kept, kept_at, color, depth, alpha,
    by_color, by_depth, by_alpha, by_layout, slots, parameters, first_moment, second_moment, rates, visible, gradient,
    pose_parts, results,
):
    """The backward pass of what `blend` has left, from the gradients by its pictures; then step.

    ``by_layout [2]``: floats per row of ``by_color`` and before the first pixel of a row.
    """
    own = LANES * take_ticket(tickets, THREAD_TICKET) * (SCRATCH // LANES)
    state, spare = scratch[own : own + 64 * _COLORED], scratch[own + 64 * _COLORED : own + SCRATCH]
    while True:
        ticket = take_ticket(tickets, 5)
        if ticket >= grid[TILES_X] * grid[TILES_Y]:
            break
        tile = tile_order[ticket]
        _read_tile(tile, grid, state, color, depth, alpha, by_color, by_depth, by_alpha, by_layout)
        x, y = _corner(tile, grid)
        place, done = kept_at[2 * tile], kept_at[2 * tile + 1]
        keeps, keep = 0, spare
        if place >= 0:
            keeps, keep = LANES, kept[place:]
        _backward(
            F(x), F(y), tile_start[tile], done, tile_start[tile + 1], entries, records, view, state, keep, keeps, slots
        )
        take_ticket(tickets, TILES_DONE)
    _step(
        tickets, parameters, first_moment, second_moment, rates, view, grid, records, visible, slots, gradient,
        pose_parts, scratch[:0], results, scratch[own : own + SCRATCH],
    )  # fmt: skip


@_entry
def score(tickets, parameters, views, grid, depth, alpha):
    """Depth and alpha of many cameras: one camera per thread at a time, from the records to the pixels."""
    chunks, tiles = grid[CHUNKS], grid[TILES_X] * grid[TILES_Y]
    records = _scratch(max(grid[COUNT] + LANES, 1) * RECORD)
    visible = np.empty(chunks * (CHUNK // LANES), np.int32)
    for block in range(len(visible)):
        visible[block] = 0
    histogram, chunk_entries = np.empty(chunks * tiles, np.int32), np.empty(chunks, np.int64)
    tile_start, tile_order = np.empty(tiles + 1, np.int64), np.empty(tiles + PLACES, np.int64)
    digits = np.empty(DIGITS, np.int64)
    state, no_color = _scratch(64 * _SCORING), np.empty(0, np.float32)
    entries = np.empty((ENTRY_ROWS, 1024), np.uint64)
    pixels = grid[WIDTH] * grid[HEIGHT]
    while True:
        camera = take_ticket(tickets, 0)
        if camera >= views.shape[0]:
            return
        view = views[camera]
        for chunk in range(chunks):
            _project_chunk(chunk, parameters, view, grid, records, visible, histogram, chunk_entries)
        total = _plan(grid, histogram, chunk_entries, tile_start, tile_order)
        if total > entries.shape[1]:
            entries = np.empty((ENTRY_ROWS, 2 * total), np.uint64)
        for chunk in range(chunks):
            _fill_chunk(chunk, grid, records, visible, histogram, chunk_entries, entries)
        own_depth = depth[camera * pixels : (camera + 1) * pixels]
        own_alpha = alpha[camera * pixels : (camera + 1) * pixels]
        for tile in range(tiles):
            start, stop = tile_start[tile], tile_start[tile + 1]
            _sort_tile(start, stop, entries, digits)
            alive = _open_tile(tile, grid, state, np.int64(_SCORING))
            x, y = _corner(tile, grid)
            _forward_without_color(F(x), F(y), start, stop, alive, entries, records, view, state, state, 0)
            _write_tile(tile, grid, state, np.int64(_SCORING), no_color, own_depth, own_alpha)


@_entry
def multiply_add(tickets, rounds, pieces, values):
    """Ten independent chains of 16-lane multiply-adds: what the processor can do at most. For the benchmark."""
    x, y = load(values, 0), load(values, LANES)
    while True:
        piece = take_ticket(tickets, 0)
        if piece >= pieces:
            return
        a, b, c, d, e = x, y, x + y, x - y, x * y
        f, g, h, i, j = x + x, y + y, x * x, y * y, y - x
        for _ in range(rounds):
            a, b, c, d, e = fma(a, x, y), fma(b, x, y), fma(c, x, y), fma(d, x, y), fma(e, x, y)
            f, g, h, i, j = fma(f, x, y), fma(g, x, y), fma(h, x, y), fma(i, x, y), fma(j, x, y)
        store(values, LANES * (2 + piece), a + b + c + d + e + f + g + h + i + j)
