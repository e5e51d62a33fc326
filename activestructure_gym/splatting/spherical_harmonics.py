"""Compute view-dependent colours from real spherical harmonics of degree 0 to 3.

The convention is that of 3D Gaussian splatting and gsplat: colour = max(0, 0.5 + sum_k Y_k(d) f_k). Here d is the unit
vector from the camera centre to the mean, and the basis has the signs of [kerbl2023, code]. Colours are evaluated once
per Gaussian. The kernels convert coefficients to colours before a rendering. Afterwards they convert the gradients by
colour to gradients by coefficients, mean and camera centre.
"""

# mypy: ignore-errors
# (the arguments of kernels have numba's types)

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numba import njit

from activestructure_gym.compiling import kernel
from activestructure_gym.compiling.thread_team import TEAM
from activestructure_gym.splatting import counters, layout

if TYPE_CHECKING:
    import torch

    Array = TypeVar("Array", np.ndarray, torch.Tensor)

TERMS = (1, 4, 9, 16)  # number of coefficients per channel for degree 0, 1, 2, 3
_TINY = 1e-30  # avoids division by 0 for a mean at the camera centre


def _make_bands(number):
    """Return the basis functions of degree 1, 2 and 3 and their derivatives, with constants in the type ``number``."""
    c1 = number(0.4886025119029199)
    c2, c20, c22 = number(1.0925484305920792), number(0.31539156525252005), number(0.5462742152960396)
    c30, c31, c32 = number(0.3731763325901154), number(0.4570457994644658), number(2.890611442640554)
    c322, c33 = number(1.445305721320277), number(0.5900435899266435)
    zero, two, three, four, six, eight = (number(value) for value in (0, 2, 3, 4, 6, 8))

    def degree_1(x, y, z):
        return -c1 * y, c1 * z, -c1 * x

    def degree_2(x, y, z):
        return (
            c2 * x * y, -c2 * y * z, c20 * (two * z * z - x * x - y * y), -c2 * x * z, c22 * (x * x - y * y),
        )  # fmt: skip

    def degree_3(x, y, z):
        xx, yy, zz = x * x, y * y, z * z
        return (
            -c33 * y * (three * xx - yy), c32 * x * y * z, -c31 * y * (four * zz - xx - yy),
            c30 * z * (two * zz - three * xx - three * yy), -c31 * x * (four * zz - xx - yy),
            c322 * z * (xx - yy), -c33 * x * (xx - three * yy),
        )  # fmt: skip

    def slopes_1(x, y, z):  # d/dx of the three, d/dy, d/dz
        return zero, zero, -c1, -c1, zero, zero, zero, c1, zero

    def slopes_2(x, y, z):  # d/dx of the five, d/dy, d/dz
        return (
            c2 * y, zero, -two * c20 * x, -c2 * z, two * c22 * x,
            c2 * x, -c2 * z, -two * c20 * y, zero, -two * c22 * y,
            zero, -c2 * y, four * c20 * z, -c2 * x, zero,
        )  # fmt: skip

    def slopes_3(x, y, z):  # d/dx of the seven, d/dy, d/dz
        xx, yy, zz, xy, xz, yz = x * x, y * y, z * z, x * y, x * z, y * z
        return (
            -six * c33 * xy, c32 * yz, two * c31 * xy, -six * c30 * xz, -c31 * (four * zz - three * xx - yy),
            two * c322 * xz, -three * c33 * (xx - yy),
            -three * c33 * (xx - yy), c32 * xz, -c31 * (four * zz - xx - three * yy), -six * c30 * yz, two * c31 * xy,
            -two * c322 * yz, six * c33 * xy,
            zero, c32 * xy, -eight * c31 * yz, c30 * (six * zz - three * xx - three * yy), -eight * c31 * xz,
            c322 * (xx - yy), zero,
        )  # fmt: skip

    return degree_1, degree_2, degree_3, slopes_1, slopes_2, slopes_3


_C0 = 0.28209479177387814  # spherical harmonic of degree 0
_DEGREES = _make_bands(float)[:3]


def evaluate_sh(
    coefficients: Array,  # [N, K, 3], K = 1, 4, 9 or 16
    directions: Array,  # [N, 3] from the camera centre to the Gaussian, any length
) -> Array:  # [N, 3]
    """Return the colours of N Gaussians, for numpy arrays or torch tensors (with gradients)."""
    x, y, z = (
        directions / ((directions * directions).sum(-1) + _TINY)[..., None] ** 0.5
    ).T  # a direction of length 0 gets the colour of degree 0
    terms = coefficients.shape[1]
    color = 0.5 + _C0 * coefficients[:, 0]
    at = 1
    for degree in _DEGREES:
        if at >= terms:
            break
        for value in degree(x, y, z):
            color = color + value[:, None] * coefficients[:, at]
            at += 1
    return color * (color >= 0)


# ---------------------------------------------------------------------------------------------------------------------

_C0_32, _HALF = np.float32(_C0), np.float32(0.5)
_degree_1, _degree_2, _degree_3, _slopes_1, _slopes_2, _slopes_3 = map(njit, _make_bands(np.float32))


@njit
def _fill_basis(basis, terms, x, y, z):
    """Write the values Y_0 to Y_(terms - 1) for the unit vector (x, y, z) to ``basis`` [16]."""
    basis[0] = _C0_32
    if terms > 1:
        basis[1], basis[2], basis[3] = _degree_1(x, y, z)
    if terms > 4:
        basis[4], basis[5], basis[6], basis[7], basis[8] = _degree_2(x, y, z)
    if terms > 9:
        basis[9], basis[10], basis[11], basis[12], basis[13], basis[14], basis[15] = _degree_3(x, y, z)


@njit
def _fill_slopes(slopes, terms, x, y, z):
    """Write the derivatives of the basis polynomials by x, y and z to rows 0 to 2 of ``slopes [3, 16]``."""
    a, b, c = slopes[0], slopes[1], slopes[2]
    a[0] = b[0] = c[0] = np.float32(0.0)
    if terms > 1:
        a[1], a[2], a[3], b[1], b[2], b[3], c[1], c[2], c[3] = _slopes_1(x, y, z)
    if terms > 4:
        (
            a[4], a[5], a[6], a[7], a[8], b[4], b[5], b[6], b[7], b[8], c[4], c[5], c[6], c[7], c[8],
        ) = _slopes_2(x, y, z)  # fmt: skip
    if terms > 9:
        (
            a[9], a[10], a[11], a[12], a[13], a[14], a[15], b[9], b[10], b[11], b[12], b[13], b[14], b[15],
            c[9], c[10], c[11], c[12], c[13], c[14], c[15],
        ) = _slopes_3(x, y, z)  # fmt: skip


@njit
def _may_be_seen(parameters, i, view, grid):
    """Return False only for Gaussians that the projection leaves out. The bound is the same, but slightly wider."""
    mx, my, mz = parameters[0, i], parameters[1, i], parameters[2, i]
    z = view[8] * mx + view[9] * my + view[10] * mz + view[11]
    if not z > np.float32(0.5) * layout.NEAR_PLANE:
        return False
    x = (view[0] * mx + view[1] * my + view[2] * mz + view[3]) / z
    y = (view[4] * mx + view[5] * my + view[6] * mz + view[7]) / z
    u, v = x * view[layout.FX] + view[layout.CX], y * view[layout.FY] + view[layout.CY]
    if u >= 0 and u < grid[layout.WIDTH] and v >= 0 and v < grid[layout.HEIGHT]:
        return True
    largest = np.exp(max(parameters[7, i], max(parameters[8, i], parameters[9, i])))
    slope_x = min(max(x, view[layout.LOW_X]), view[layout.HIGH_X])
    slope_y = min(max(y, view[layout.LOW_Y]), view[layout.HIGH_Y])
    across, down = largest * view[layout.FX] / z, largest * view[layout.FY] / z
    size = across * across * (np.float32(1.0) + slope_x * slope_x) + down * down * (np.float32(1.0) + slope_y * slope_y)
    reach = np.float32(3.4) * np.sqrt(size + view[layout.BLUR]) + np.float32(1.0)
    return u + reach > 0 and u - reach < grid[layout.WIDTH] and v + reach > 0 and v - reach < grid[layout.HEIGHT]


@njit
def _direction(parameters, i, centre):
    """Return the unit vector from the camera centre to the mean of Gaussian i, and the inverse of the distance."""
    x, y, z = parameters[0, i] - centre[0], parameters[1, i] - centre[1], parameters[2, i] - centre[2]
    inverse = np.float32(1.0) / np.sqrt(x * x + y * y + z * z + np.float32(_TINY))
    return x * inverse, y * inverse, z * inverse, inverse


@kernel
def _shade(tickets, parameters, view, grid, centre, coefficients):
    """Write the colours of Gaussians to rows 11 to 13 of the parameters, from ``coefficients [N, K, 3]``."""
    terms, basis = coefficients.shape[1], np.empty(16, np.float32)
    while True:
        chunk = counters.take_ticket(tickets, 0)
        if chunk >= grid[layout.CHUNKS]:
            return
        for i in range(chunk * layout.CHUNK, min((chunk + 1) * layout.CHUNK, grid[layout.COUNT])):
            r = g = b = np.float32(0.0)
            if _may_be_seen(parameters, i, view, grid):
                x, y, z, _ = _direction(parameters, i, centre)
                _fill_basis(basis, terms, x, y, z)
                r = g = b = _HALF
                for term in range(terms):
                    value = basis[term]
                    r += value * coefficients[i, term, 0]
                    g += value * coefficients[i, term, 1]
                    b += value * coefficients[i, term, 2]
            zero = np.float32(0.0)
            parameters[11, i] = r if r > zero else zero
            parameters[12, i] = g if g > zero else zero
            parameters[13, i] = b if b > zero else zero


@kernel
def _unshade(tickets, parameters, grid, centre, coefficients, gradient, by_coefficients, by_centre):
    """Convert gradients by colour (rows 11 to 13 of ``gradient``) to gradients by mean, coefficients, camera centre.

    They are added to rows 0 to 2 and to ``by_coefficients [N, K, 3]``. The gradient by the camera centre from each
    chunk is written to ``by_centre [chunks, 3]``.
    """
    terms, zero = coefficients.shape[1], np.float32(0.0)
    basis, slopes = np.empty(16, np.float32), np.empty((3, 16), np.float32)
    while True:
        chunk = counters.take_ticket(tickets, 0)
        if chunk >= grid[layout.CHUNKS]:
            return
        total_x = total_y = total_z = 0.0
        for i in range(chunk * layout.CHUNK, min((chunk + 1) * layout.CHUNK, grid[layout.COUNT])):
            r, g, b = gradient[11, i], gradient[12, i], gradient[13, i]
            if r == zero and g == zero and b == zero:
                continue
            x, y, z, inverse = _direction(parameters, i, centre)
            _fill_basis(basis, terms, x, y, z)
            red = green = blue = _HALF
            for term in range(terms):
                value = basis[term]
                red += value * coefficients[i, term, 0]
                green += value * coefficients[i, term, 1]
                blue += value * coefficients[i, term, 2]
            r, g, b = r if red >= zero else zero, g if green >= zero else zero, b if blue >= zero else zero
            for term in range(terms):
                value = basis[term]
                by_coefficients[i, term, 0] += value * r
                by_coefficients[i, term, 1] += value * g
                by_coefficients[i, term, 2] += value * b
            if terms == 1:
                continue
            _fill_slopes(slopes, terms, x, y, z)
            by_x = by_y = by_z = zero
            for term in range(1, terms):
                share = coefficients[i, term, 0] * r + coefficients[i, term, 1] * g + coefficients[i, term, 2] * b
                by_x += slopes[0, term] * share
                by_y += slopes[1, term] * share
                by_z += slopes[2, term] * share
            along = x * by_x + y * by_y + z * by_z  # a change of the mean along the ray changes no colour
            by_x, by_y = (by_x - x * along) * inverse, (by_y - y * along) * inverse
            by_z = (by_z - z * along) * inverse
            gradient[0, i] += by_x
            gradient[1, i] += by_y
            gradient[2, i] += by_z
            total_x, total_y, total_z = total_x - by_x, total_y - by_y, total_z - by_z
        by_centre[chunk, 0], by_centre[chunk, 1], by_centre[chunk, 2] = total_x, total_y, total_z


def camera_centre(camera_from_world: np.ndarray) -> np.ndarray:  # [4, 4] -> [3]
    """Return the camera centre in the world; ``camera_from_world`` is inverted as a general matrix, as in gsplat."""
    pose = np.asarray(camera_from_world, np.float64)
    return -np.linalg.solve(pose[:3, :3], pose[:3, 3])


def shade(
    parameters: np.ndarray,  # [14, capacity] float32; rows 11 to 13 are output
    coefficients: np.ndarray,  # [N, K, 3] float32
    camera_from_world: np.ndarray,  # [4, 4]
    view: np.ndarray,  # see `workspace.make_view`
    grid: np.ndarray,  # see `workspace.make_grid`
    threads: int,
) -> None:
    """Write the colours of the Gaussians that a camera may see to the parameters; the others get black."""
    centre = camera_centre(camera_from_world).astype(np.float32)
    TEAM.run(_shade, (np.zeros(1, np.int64), parameters, view, grid, centre, coefficients), threads)


def unshade(
    parameters: np.ndarray,  # [14, capacity] float32
    coefficients: np.ndarray,  # [N, K, 3] float32
    camera_from_world: np.ndarray,  # [4, 4]
    grid: np.ndarray,  # see `workspace.make_grid`
    gradient: np.ndarray,  # [14, capacity] float32: rows 11 to 13 are read, results are added to rows 0 to 2
    by_coefficients: np.ndarray,  # [N, K, 3] float32: results are added
    threads: int,
) -> np.ndarray:  # [3, 4] gradient by camera_from_world, through the camera centre
    """Convert gradients by colour to gradients by mean, coefficients and camera pose: the backward pass of `shade`."""
    centre = camera_centre(camera_from_world)
    parts = np.zeros((int(grid[layout.CHUNKS]), 3))
    arguments = (parameters, grid, centre.astype(np.float32), coefficients, gradient, by_coefficients, parts)
    TEAM.run(_unshade, (np.zeros(1, np.int64), *arguments), threads)
    # The camera centre is -R^-1 t, so a change of R and t moves it by -R^-1 (dt + dR centre).
    by_translation = -np.linalg.solve(np.asarray(camera_from_world, np.float64)[:3, :3].T, parts.sum(axis=0))
    return np.concatenate([np.outer(by_translation, centre), by_translation[:, None]], axis=1)
