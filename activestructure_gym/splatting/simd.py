"""Define vectors for kernels: 16 float32, 16 int32 or 16 bits as one numba value (SIMD), and their arithmetic.

The operators become LLVM vector instructions (AVX-512, AVX2, SSE or NEON, selected by LLVM). The elements of a vector
are its lanes.
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

# Functions with `inner` and `inline` are called from other kernels only, so no entry point for Python is compiled. They
# do not count references to arrays, which would cost eight atomic additions per block of Gaussians, on cache lines
# shared by all threads. A function without reference counting cannot allocate memory; the few that must are
# `allocating`. Integer arguments that vary are converted by np.int64, since numba compiles a function anew for every
# integer literal.
_plain = {"error_model": "numpy", "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
inner, inline = njit(_nrt=False, **_plain), njit(_nrt=False, forceinline=True, **_plain)
allocating = njit(**_plain)

F, U64 = np.float32, np.uint64
LANES = 16  # lanes of a vector


class _Vector(types.Type):
    def __init__(self) -> None:
        super().__init__(name=type(self).__name__)


class Floats(_Vector):
    """Represent a vector of 16 float32 as a numba type."""


class Ints(_Vector):
    """Represent a vector of 16 int32 as a numba type."""


class Mask(_Vector):
    """Represent a vector of 16 bits as a numba type."""


floats, ints, mask16 = Floats(), Ints(), Mask()
F32, I32, I64, BIT = ir.FloatType(), ir.IntType(32), ir.IntType(64), ir.IntType(1)
FLOATS, INTS, MASK = (ir.VectorType(element, LANES) for element in (F32, I32, BIT))
for _numba_type, _llvm_type in ((Floats, FLOATS), (Ints, INTS), (Mask, MASK)):

    @register_model(_numba_type)
    class _Model(models.PrimitiveModel):
        def __init__(self, dmm, fe_type, llvm_type=_llvm_type) -> None:
            super().__init__(dmm, fe_type, llvm_type)


def spread_value(builder, value):
    """Return an LLVM vector with the same number in every lane; vectors are returned unchanged."""
    if isinstance(value.type, ir.VectorType):
        return value
    vector = ir.VectorType(value.type, LANES)
    first = builder.insert_element(ir.Constant(vector, ir.Undefined), value, ir.Constant(I32, 0))
    return builder.shuffle_vector(first, ir.Constant(vector, ir.Undefined), ir.Constant(INTS, [0] * LANES))


def _operator(op, operand, scalar, result, emit) -> None:
    """Register the operator ``op`` for two vectors, and for a vector and a number in either order.

    ``operand``, ``scalar`` and ``result`` are their numba types; None for ``scalar`` means vectors only. ``emit``
    builds the LLVM instruction.
    """
    cases = [signature(result, operand, operand)]
    if scalar is not None:
        cases += [signature(result, operand, scalar), signature(result, scalar, operand)]
    infer_global(op)(type("Template", (ConcreteTemplate,), {"cases": cases}))

    def lower(context, builder, sig, args):
        return emit(builder, spread_value(builder, args[0]), spread_value(builder, args[1]))

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


def call_llvm(builder, name, result, args):
    """Emit a call of an LLVM function, and declare the function if it is missing."""
    function = cgutils.get_or_insert_function(builder.module, ir.FunctionType(result, [arg.type for arg in args]), name)
    return builder.call(function, args)


def _as_floats(kind):
    return floats if isinstance(kind, Floats) else types.float32


def _elementwise(llvm_name, arity):
    """Return an intrinsic for the LLVM function ``llvm_name`` with ``arity`` float arguments, applied lane by lane.

    Numbers are spread to all lanes.
    """

    def codegen(context, builder, sig, args):
        return call_llvm(builder, f"{llvm_name}.v16f32", FLOATS, [spread_value(builder, arg) for arg in args])

    if arity == 1:
        return intrinsic(lambda typingctx, a: (floats(floats), codegen))
    return intrinsic(lambda typingctx, a, b, c: (floats(*map(_as_floats, (a, b, c))), codegen))


# llvm.fmuladd and not llvm.fma, which becomes one library call per lane on processors without FMA instructions.
fma = _elementwise("llvm.fmuladd", 3)
sqrt = _elementwise("llvm.sqrt", 1)
floor = _elementwise("llvm.floor", 1)
ceil = _elementwise("llvm.ceil", 1)


@intrinsic
def neg(typingctx, a):
    """Return the negative of a vector of floats."""
    return floats(floats), lambda context, builder, sig, args: builder.fneg(args[0])


@intrinsic
def spread(typingctx, a):
    """Return a vector with the same float in every lane."""
    return floats(types.float32), lambda context, builder, sig, args: spread_value(builder, args[0])


@intrinsic
def sel(typingctx, mask, a, b):
    """Return ``a`` in lanes where the mask is true, and ``b`` in the others."""
    kind = ints if ints in (a, b) else floats
    scalar = types.int32 if kind is ints else types.float32
    arguments = [kind if isinstance(x, _Vector) else scalar for x in (a, b)]

    def codegen(context, builder, sig, args):
        return builder.select(args[0], spread_value(builder, args[1]), spread_value(builder, args[2]))

    return kind(mask16, *arguments), codegen


@intrinsic
def bits(typingctx, mask):
    """Return a mask as an integer; lane 0 is the lowest bit."""

    def codegen(context, builder, sig, args):
        return builder.zext(builder.bitcast(args[0], ir.IntType(16)), I64)

    return types.int64(mask16), codegen


@intrinsic
def to_int(typingctx, a):
    """Return floats as integers, rounded towards zero."""
    return ints(floats), lambda context, builder, sig, args: builder.fptosi(args[0], INTS)


@intrinsic
def to_float(typingctx, a):
    """Return integers as floats."""
    return floats(ints), lambda context, builder, sig, args: builder.sitofp(args[0], FLOATS)


@intrinsic
def int_bits(typingctx, a):
    """Return integers with the same bits as the floats."""
    return ints(floats), lambda context, builder, sig, args: builder.bitcast(args[0], INTS)


@intrinsic
def float_bits(typingctx, a):
    """Return floats with the same bits as the integers."""
    return floats(ints), lambda context, builder, sig, args: builder.bitcast(args[0], FLOATS)


def _constant(values):
    def codegen(context, builder, sig, args):
        return ir.Constant(FLOATS, [float(value) for value in values])

    return intrinsic(lambda typingctx: (floats(), codegen))


lane_index = _constant(range(LANES))
# Column of each pixel's centre in a block of 4 x 4 pixels.
lane_x = _constant([(lane % 4) + 0.5 for lane in range(LANES)])
lane_y = _constant([(lane // 4) + 0.5 for lane in range(LANES)])  # row of each pixel's centre
