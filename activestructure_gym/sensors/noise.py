"""Simulate noise of depth cameras and pose trackers. Off by default: the paper uses perfect depth and poses.

The sources state lateral effects in pixels of a 640-wide depth camera. They are converted to the same angle here, so
small images are not blurred more than large ones.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from activestructure_gym.geometry import PinholeCamera, se3_exp
from activestructure_gym.geometry.depth_noise import axial_sigma

DepthNoise = Literal["none", "kinect", "redwood"]
DEPTH_NOISE: tuple[DepthNoise, ...] = get_args(DepthNoise)

_SOURCE_FOCAL = 525.0  # px; both models were measured with this 640-wide camera
_DISPARITY_METRES = 35.130  # px m, focal length times baseline: the disparity is this number over the depth (Redwood)
_DISPARITY_STEP = 1.0 / 8.0  # px, step to which disparities are rounded
_DISPARITY_SIGMA = 0.027778  # px, standard deviation of the disparity (Redwood)
_REDWOOD_RANGE = 10.0  # m; the Redwood model returns nothing beyond
# The terms of [nguyen2012] grow without limit towards 90 degrees. They were fitted up to 60 degrees, and incidence is
# limited to this angle (radians).
_MAX_INCIDENCE = np.radians(80.0)
_DROPOUT_JUMP = 0.05  # relative depth difference above which neighbouring pixels show two surfaces
_DROPOUT_RADIUS = 2.0  # px of the source camera; pixels this near to a depth jump are at risk
_DROPOUT_INCIDENCE = np.radians(75.0)  # incidence above which pixels are at risk
# Fraction of the pixels at risk that is lost: 1 to 9 % of an image in the four test scenes. Real frames lose 7 to 12 %,
# including dark and shiny surfaces, which are not modelled.
_DROPOUT_SHARE = 0.5


def _slope(values: np.ndarray, valid: np.ndarray, axis: int) -> np.ndarray:
    """Return the difference of each pixel of ``values`` [H, W] to its neighbour along ``axis``.

    Of the two neighbours, the valid one with the smaller difference counts, since it is on the same surface at edges.
    """
    values, valid = np.moveaxis(values, axis, 0), np.moveaxis(valid, axis, 0)
    step = np.full((len(values) + 1, *values.shape[1:]), np.inf)
    step[1:-1] = np.where(valid[1:] & valid[:-1], values[1:] - values[:-1], np.inf)
    before, after = step[:-1], step[1:]
    smaller = np.where(np.abs(before) < np.abs(after), before, after)
    return np.moveaxis(np.where(np.isfinite(smaller), smaller, 0.0), 0, axis)


def incidence_angles(depth: np.ndarray, camera: PinholeCamera) -> np.ndarray:  # [H, W] -> [H, W]
    """Return the angle in radians between the ray of each pixel and the surface normal; 0 where there is no return.

    The normal is computed from the slopes of the inverse depth. This is exact on a plane n . p = d, where the inverse
    depth n . ray / d is linear in the pixel coordinates.
    """
    valid = depth > 0
    inverse = np.where(valid, 1.0 / np.where(valid, depth, 1.0), 0.0)
    du, dv = _slope(inverse, valid, 1), _slope(inverse, valid, 0)
    rays = camera.rays().astype(np.float64)
    nx, ny = du * camera.fx, dv * camera.fy
    nz = inverse - rays[..., 0] * nx - rays[..., 1] * ny
    length = np.sqrt((nx**2 + ny**2 + nz**2) * (rays**2).sum(axis=-1))
    return np.where(valid, np.arccos(np.clip(inverse / np.maximum(length, 1e-12), 0.0, 1.0)), 0.0)


def kinect_sigma(depth: np.ndarray, incidence: np.ndarray) -> np.ndarray:
    """Return the standard deviation in metres of the axial error of a Kinect v1 ([nguyen2012]).

    z is the depth in metres and theta the incidence in radians, at most 80 degrees:
    0.0012 + 0.0019 (z - 0.4)^2 + 0.0001 / sqrt(z) * theta^2 / (pi / 2 - theta)^2
    """
    theta = np.minimum(incidence, _MAX_INCIDENCE)
    slant = theta**2 / (np.pi / 2.0 - theta) ** 2
    return axial_sigma(depth) + 0.0001 / np.sqrt(depth) * slant


def _quantised(disparity: np.ndarray, step: float) -> np.ndarray:
    """Return the depth in metres of ``disparity`` px, rounded to multiples of ``step`` px; 0 where it rounds to 0."""
    disparity = np.round(disparity / step) * step
    return np.where(disparity > 1e-5, _DISPARITY_METRES / np.maximum(disparity, 1e-5), 0.0)


def _jittered(
    shape: tuple[int, ...], sigma: np.ndarray | float, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:  # [H, W] rows, [H, W] columns
    """Return for each pixel its position displaced by Gaussian noise of ``sigma`` px, rounded, within the image."""
    height, width = shape
    off = np.rint(rng.standard_normal((2, height, width)) * sigma).astype(int)
    rows = np.clip(np.arange(height)[:, None] + off[0], 0, height - 1)
    columns = np.clip(np.arange(width)[None, :] + off[1], 0, width - 1)
    return rows, columns


def _kinect(depth: np.ndarray, camera: PinholeCamera, rng: np.random.Generator, multiplier: float) -> np.ndarray:
    incidence = incidence_angles(depth, camera)
    theta = np.minimum(incidence, _MAX_INCIDENCE)
    lateral = (0.8 + 0.035 * theta / (np.pi / 2.0 - theta)) * camera.fx / _SOURCE_FOCAL
    moved = depth[_jittered(depth.shape, multiplier * lateral, rng)]
    safe = np.where(moved > 0, moved, 1.0)
    noisy = safe + multiplier * kinect_sigma(safe, incidence) * rng.standard_normal(depth.shape)
    measured = _quantised(_DISPARITY_METRES / np.maximum(noisy, 1e-3), multiplier * _DISPARITY_STEP)
    return np.where((moved > 0) & (noisy > 0), measured, 0.0)


def _redwood(depth: np.ndarray, camera: PinholeCamera, rng: np.random.Generator, multiplier: float) -> np.ndarray:
    scale = multiplier * camera.fx / _SOURCE_FOCAL
    rows, columns = _jittered(depth.shape, 0.25 * scale, rng)
    block = max(1, round(2.0 * scale))  # the source camera measures one depth per 2 x 2 pixels
    moved = depth[rows // block * block, columns // block * block]
    seen = (moved > 0) & (moved < _REDWOOD_RANGE)
    disparity = _DISPARITY_METRES / np.where(seen, moved, 1.0)
    disparity = disparity + multiplier * _DISPARITY_SIGMA * rng.standard_normal(depth.shape)
    return np.where(seen, _quantised(disparity, multiplier * _DISPARITY_STEP), 0.0)


def noisy_depth(
    depth: np.ndarray,  # [H, W] float32 metres, 0 = no return
    camera: PinholeCamera,
    rng: np.random.Generator,
    *,
    model: DepthNoise,
    multiplier: float = 1.0,
) -> np.ndarray:  # [H, W] float32
    """Return the depth image with the noise of a camera model; ``multiplier`` scales every error, 0 changes nothing.

    ``kinect``: axial noise of `kinect_sigma`, lateral noise of at least 0.8 px, disparity in steps of 1/8 px.
    ``redwood``: the simulation of [choi2015] without its lens distortion table. Its disparity is 35.13 / z + N(0,
    0.0278) px in steps of 1/8 px. Lateral noise is 0.25 px, resolution one value per 2 x 2 px, range 10 m. Unlike here,
    the source's own multiplier does not scale the disparity step.
    """
    if model not in DEPTH_NOISE:
        raise ValueError(f"model must be one of {', '.join(DEPTH_NOISE)}, got {model!r}")
    if model == "none" or multiplier == 0:
        return depth
    apply = _kinect if model == "kinect" else _redwood
    return apply(depth.astype(np.float64), camera, rng, multiplier).astype(np.float32)


def drop_edges(
    measured: np.ndarray,  # [H, W] float32 metres, 0 = no return
    depth: np.ndarray,  # [H, W] noise-free depth; noise would be mistaken for edges and slants
    camera: PinholeCamera,
    rng: np.random.Generator,
) -> np.ndarray:  # [H, W] float32
    """Return measured depth with holes (0) where structured light fails: near depth edges and on slanted surfaces.

    Two kinds of pixels are at risk:

    - within 2 px (of a 640-wide camera, at least 1) of a depth jump of more than 5 %;
    - on surfaces with more than 75 deg incidence.

    Half of them, drawn at random, are lost.
    """
    import cv2

    jump = np.zeros(depth.shape, bool)
    for values, marks in ((depth, jump), (depth.T, jump.T)):  # marks is a view: both directions are written to jump
        first, second = values[1:], values[:-1]
        edge = np.abs(first - second) > _DROPOUT_JUMP * np.minimum(first, second)
        marks[1:] |= edge
        marks[:-1] |= edge
    # Both pixels of a jump are marked already, which is a radius of 1.
    radius = max(1, round(_DROPOUT_RADIUS * camera.fx / _SOURCE_FOCAL)) - 1
    if radius:
        jump = cv2.dilate(jump.astype(np.uint8), np.ones((2 * radius + 1, 2 * radius + 1), np.uint8)) > 0
    at_risk = jump | (incidence_angles(depth, camera) > _DROPOUT_INCIDENCE)
    lost = at_risk & (rng.random(depth.shape) < _DROPOUT_SHARE)
    return np.where(lost, np.float32(0.0), measured)


def noisy_pose(
    world_from_camera: np.ndarray,  # [4, 4]
    rng: np.random.Generator,
    *,
    sigma_m: float,  # standard deviation of the translation, metres per axis
    sigma_deg: float,  # standard deviation of the rotation vector, degrees per axis
) -> np.ndarray:  # [4, 4]
    """Return the pose with a random error: world_from_camera exp(twist), with a Gaussian twist in the camera frame.

    Errors of successive poses are independent; there is no drift.
    """
    if sigma_m == 0 and sigma_deg == 0:
        return world_from_camera
    tangent = rng.standard_normal(6) * np.repeat([sigma_m, np.radians(sigma_deg)], 3)
    return world_from_camera @ se3_exp(tangent)
