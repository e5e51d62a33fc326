"""Convert between rotation matrices and unit quaternions in the order w, x, y, z.

Import this module directly: the package ``geometry`` does not import it, because it loads numba. Conversions that are
not frequent use `scipy.spatial.transform.Rotation`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from activestructure_gym.compiling import kernel

# Rounding gives products of rotation matrices errors below this. Matrices with larger errors go to scipy, which
# orthonormalises matrices that are off by 1e-12.
_ORTHONORMAL = 1e-13


def matrix_rows(w: Any, x: Any, y: Any, z: Any) -> tuple[tuple[Any, Any, Any], ...]:  # 3 rows of 3
    """Return the rotation matrix of the unit quaternion w + xi + yj + zk, row by row.

    The arguments are four numbers or four arrays of one shape; each entry of the result has that shape.
    """
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


def turned(rotation: np.ndarray, quaternions: np.ndarray) -> np.ndarray:  # [N, 4] wxyz
    """Return the Hamilton products ``rotation * q`` of one quaternion [4] with each q of ``quaternions`` [N, 4]."""
    w, x, y, z = rotation
    matrix = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
    return quaternions @ matrix.T


def quaternion_of(rotation: np.ndarray) -> np.ndarray:  # [4] wxyz, w >= 0
    """Return the unit quaternion of a rotation matrix [3, 3], with w >= 0."""
    x, y, z, w = Rotation.from_matrix(rotation).as_quat()
    return np.array([w, x, y, z]) * (1.0 if w >= 0 else -1.0)


def quaternions(
    rotations: np.ndarray,  # [N, 3, 3]
    *,
    canonical: bool = False,  # whether to choose between q and -q the one with a positive first nonzero component
) -> np.ndarray:  # [N, 4] unit, wxyz
    """Return the unit quaternions of rotation matrices, bit-equal to scipy's `Rotation.from_matrix` but faster.

    Raises `ValueError` for a matrix without a nearest rotation (a reflection), as scipy does.
    """
    found, error = _quaternions(np.ascontiguousarray(rotations, dtype=np.float64), canonical)
    if not error < _ORTHONORMAL:
        found = Rotation.from_matrix(rotations).as_quat(scalar_first=True, canonical=canonical)
    return np.asarray(found)


@kernel
def _quaternions(m: np.ndarray, canonical: bool) -> tuple[np.ndarray, float]:  # [N, 4] wxyz, largest |R R^T - I|
    """Compute the unit quaternions of matrices m [N, 3, 3] from the largest of the four squares ([shepperd1978]).

    Also return the largest deviation of a matrix from orthonormality; it is infinite if one is a reflection.
    """
    result, error = np.empty((len(m), 4)), 0.0
    for n in range(len(m)):
        determinant = 0.0
        for a in range(3):
            b, c = (a + 1) % 3, (a + 2) % 3
            determinant += m[n, 0, a] * (m[n, 1, b] * m[n, 2, c] - m[n, 1, c] * m[n, 2, b])
            for b in range(a + 1):
                product = m[n, a, 0] * m[n, b, 0] + m[n, a, 1] * m[n, b, 1] + m[n, a, 2] * m[n, b, 2]
                off = abs(product - (1.0 if a == b else 0.0))
                if not off <= error:  # also true for nan
                    error = off
        if determinant < 0.0:
            error = np.inf
        q, i = result[n], 0
        for a in range(1, 3):
            if m[n, a, a] > m[n, i, i]:
                i = a
        trace = m[n, 0, 0] + m[n, 1, 1] + m[n, 2, 2]
        if trace > m[n, i, i]:
            q[0] = 1.0 + trace
            q[1], q[2], q[3] = m[n, 2, 1] - m[n, 1, 2], m[n, 0, 2] - m[n, 2, 0], m[n, 1, 0] - m[n, 0, 1]
        else:
            j, k = (i + 1) % 3, (i + 2) % 3
            q[0], q[1 + i] = m[n, k, j] - m[n, j, k], 1.0 - trace + 2.0 * m[n, i, i]
            q[1 + j], q[1 + k] = m[n, j, i] + m[n, i, j], m[n, k, i] + m[n, i, k]
        length = np.sqrt(q[1] * q[1] + q[2] * q[2] + q[3] * q[3] + q[0] * q[0])
        if canonical:
            for a in range(4):
                if q[a] != 0.0:
                    length = -length if q[a] < 0.0 else length
                    break
        for a in range(4):
            q[a] = q[a] / length
    return result, error
