"""Compute elementary functions of vectors of 16 floats: powers and logarithms of 2, minimum and maximum."""

# mypy: ignore-errors
# (the arguments of kernels have numba's types, and intrinsics are called without their typing context)

from __future__ import annotations

import numpy as np

from activestructure_gym.splatting.layout import EXP_1, EXP_2, EXP_3, EXP_4, EXP_5, MAGIC, ONE
from activestructure_gym.splatting.memory import peek
from activestructure_gym.splatting.simd import F, float_bits, fma, inline, int_bits, sel, spread, to_float


@inline
def exp2(x):
    """Return 2^x for -126 < x < 126 by a polynomial that is most accurate near 1, where 1 - alpha needs it."""
    shifted = x + F(12582912.0)  # 1.5 * 2^23: after the addition the low bits hold the nearest integer
    f = x - (shifted - F(12582912.0))
    q = fma(f, fma(f, fma(f, fma(f, F(1.3264725e-3), F(9.6715127e-3)), F(5.5507337e-2)), F(0.24022242)), F(0.69314698))
    return float_bits(int_bits(fma(f, q, F(1.0))) + (int_bits(shifted) << np.int32(23)))


@inline
def exp2_hot(x, view):
    """Return 2^x as `exp2`, with the constants read from ``view`` in memory."""
    shifted = x + peek(view, MAGIC)
    f = x - (shifted - peek(view, MAGIC))
    q = fma(f, spread(peek(view, EXP_5)), peek(view, EXP_4))
    q = fma(f, fma(f, fma(f, q, peek(view, EXP_3)), peek(view, EXP_2)), peek(view, EXP_1))
    return float_bits(int_bits(fma(f, q, peek(view, ONE))) + (int_bits(shifted) << np.int32(23)))


@inline
def log2_of(x):
    """Return log2 of normal positive floats: the exponent, plus a series of the mantissa in [1/sqrt 2, sqrt 2)."""
    whole = (int_bits(x) - np.int32(0x3F3504F3)) >> np.int32(23)
    mantissa = float_bits(int_bits(x) - (whole << np.int32(23)))
    y = (mantissa - F(1.0)) / (mantissa + F(1.0))
    square = y * y
    series = fma(square, fma(square, fma(square, fma(square, F(0.32059890), F(0.41219858)), F(0.57707802)),
                             F(0.96179669)), F(2.88539008))  # fmt: skip
    return fma(y, series, to_float(whole))


@inline
def smaller(a, b):
    """Return the minimum in each lane; ``b`` if one of the two is NaN."""
    return sel(a < b, a, b)


@inline
def larger(a, b):
    """Return the maximum in each lane; ``b`` if one of the two is NaN."""
    return sel(a > b, a, b)


@inline
def clamped(value, low, high):
    """Return the value limited to [low, high] in each lane."""
    return smaller(larger(value, low), high)


@inline
def dot3(a0, a1, a2, b0, b1, b2):
    """Return the dot product of the vectors (a0, a1, a2) and (b0, b1, b2), in each lane."""
    return fma(a2, b2, fma(a1, b1, a0 * b0))
