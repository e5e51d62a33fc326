"""Compute POp-GS's gains with 6 x 6 blocks per Gaussian, which include the correlations of mean and log-scales."""

from __future__ import annotations

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.features.context import FeatureContext
from activestructure_gym.features.information import (
    LAMBDA,
    LOG_SCALE,
    MEAN,
    informed_views,
    register_both,
    trained,
    units,
)
from activestructure_gym.splatting.fisher import BLOCK_NUMBERS

_LANES = 64  # number of Gaussians processed together, for SIMD
_ROW, _COLUMN = np.triu_indices(6)


@register_both("popgs_logdet_block")
def popgs_logdet_block(context: FeatureContext) -> np.ndarray:  # [K]
    """Compute the sum of log det(H_train + lambda + H_c) - log det(H_train + lambda), per Gaussian of the map.

    H_train and H_c are the Fisher information of all keyframes and of the candidate, as 6 x 6 blocks of each Gaussian.
    Source: [popgs], D-optimality.
    """
    return _block_gains(context, 0, 1.0)


@register_both("popgs_cov_trace_block")
def popgs_cov_trace_block(context: FeatureContext) -> np.ndarray:  # [K]
    """Compute the sum of tr (H_train + lambda)^-1 - tr (H_train + lambda + H_c)^-1, per Gaussian of the map.

    H_train and H_c are the Fisher information of all keyframes and of the candidate, as 6 x 6 blocks of each Gaussian.
    Source: [popgs], where it is called T-optimality.
    """
    return _block_gains(context, 1, -1.0)


def _block_gains(context: FeatureContext, number: int, sign: float) -> np.ndarray:  # [K]
    """Return, for each candidate, the mean over Gaussians of how much it changes a column of `block_numbers`.

    ``number`` is the column: 0 for log det, 1 for the trace of the inverse. ``sign`` makes the change positive.
    """
    unit = context.once(units)
    root = np.sqrt(np.repeat(unit[[MEAN, LOG_SCALE]], 3))
    inverse_units = 1.0 / (root[_ROW] * root[_COLUMN])
    prior = trained(context)[:, :BLOCK_NUMBERS] * inverse_units
    count, none = len(prior), np.zeros((0, BLOCK_NUMBERS), np.float32)
    before = block_numbers(prior, np.arange(count), none, inverse_units, LAMBDA)[:, number]
    sums = []
    for view in informed_views(context):
        blocks = np.ascontiguousarray(view.blocks)  # another memory layout would compile the kernel again
        after = block_numbers(prior, view.indices, blocks, inverse_units, LAMBDA)[:, number]
        # Information never decreases. In a block with entries of 10^5 units, rounding errors are as large as lambda.
        sums.append(np.maximum(sign * (after - before[view.indices]), 0.0).sum())
    return np.array(sums) / max(1, count)


@kernel
def block_numbers(
    prior: np.ndarray,  # [N, 21] float64, upper triangles row by row
    indices: np.ndarray,  # [S] int64, rows of ``prior``
    blocks: np.ndarray,  # [S, 21] float32 blocks to add, or [0, 21] for none
    inverse_units: np.ndarray,  # [21] factor on ``blocks``
    least: float,  # lambda, added to the diagonal
) -> np.ndarray:  # [S, 2]: log of the determinant, trace of the inverse
    """Return log det and trace of the inverse of ``prior[indices] + inverse_units x blocks + least I``.

    The matrices are decomposed as L D L^T, 64 at once. The pivots of a positive semi-definite matrix plus lambda I are
    at least lambda; smaller ones due to rounding are replaced by lambda.
    """
    count = len(indices)
    n = int(np.sqrt(2.0 * prior.shape[1]))  # 6, computed here because the compiler would unroll loops of a known length
    result = np.empty((count, 2))
    a = np.empty((n, n, _LANES))  # the matrices, overwritten by D on the diagonal and L below it
    inverse = np.empty((n, _LANES))
    product, trace = np.empty(_LANES), np.empty(_LANES)
    for first in range(0, count, _LANES):
        many = min(_LANES, count - first)
        entry = 0
        for row in range(n):
            for column in range(row, n):
                for lane in range(many):
                    value = prior[indices[first + lane], entry]
                    if len(blocks) != 0:
                        value += inverse_units[entry] * blocks[first + lane, entry]
                    a[column, row, lane] = value + (least if row == column else 0.0)
                entry += 1
        for lane in range(_LANES):
            product[lane], trace[lane] = 1.0, 0.0
        for j in range(n):
            for lane in range(_LANES):
                a[j, j, lane] = max(a[j, j, lane], least)
                product[lane] *= a[j, j, lane]
            for i in range(j + 1, n):
                for lane in range(_LANES):
                    inverse[i, lane] = a[i, j, lane] / a[j, j, lane]
                for column in range(j + 1, i + 1):
                    for lane in range(_LANES):
                        a[i, column, lane] -= inverse[i, lane] * a[column, j, lane]
            for i in range(j + 1, n):
                for lane in range(_LANES):
                    a[i, j, lane] = inverse[i, lane]
        # tr A^-1 is the sum of the squared entries of L^-1, each divided by D of its row. Columns follow one another.
        for j in range(n):
            for i in range(j, n):
                for lane in range(_LANES):
                    inverse[i, lane] = 1.0 if i == j else 0.0
                for k in range(j, i):
                    for lane in range(_LANES):
                        inverse[i, lane] -= a[i, k, lane] * inverse[k, lane]
                for lane in range(_LANES):
                    trace[lane] += inverse[i, lane] * inverse[i, lane] / a[i, i, lane]
        for lane in range(many):
            result[first + lane, 0], result[first + lane, 1] = np.log(product[lane]), trace[lane]
    return result
