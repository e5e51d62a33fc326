"""Compute with rigid transforms, given as 4x4 float64 matrices [R t; 0 1] with rotation R and translation t in metres.

For interpolation and conversions use `scipy.spatial.transform.Rotation`.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

_ROUNDED = 1e-6  # rotations R with an entry of R R^T - I above this are replaced by `unrounded`


def invert_rigid(transform: np.ndarray) -> np.ndarray:
    """Return the inverses of rigid transforms ``[..., 4, 4]``.

    The inverse is [R^T, -R^T t]: it needs no numerical matrix inversion.
    """
    transform = np.asarray(transform, dtype=np.float64)
    rotation = np.swapaxes(transform[..., :3, :3], -1, -2)
    inverse = np.zeros_like(transform)
    inverse[..., :3, :3] = rotation
    inverse[..., :3, 3] = -(rotation @ transform[..., :3, 3, None])[..., 0]
    inverse[..., 3, 3] = 1.0
    return inverse


def transform_points(
    transform: np.ndarray,  # [4, 4]
    points: np.ndarray,  # [..., 3]
) -> np.ndarray:  # [..., 3]
    """Return ``R p + t`` for each point p, where R and t are the rotation and translation of ``transform``."""
    return points @ transform[:3, :3].T + transform[:3, 3]


def unrounded(poses: np.ndarray) -> np.ndarray:
    """Return poses ``[..., 4, 4]`` whose rotations are orthonormal, as poses read from files with few digits are not.

    A rotation R with an entry of R R^T - I above 1e-6 is replaced by the nearest rotation; the others are unchanged.
    The input must be nearly rigid. The last row of each pose becomes (0, 0, 0, 1).
    """
    poses = np.array(poses, dtype=np.float64)
    rotations = poses[..., :3, :3]
    off = np.abs(rotations @ np.swapaxes(rotations, -1, -2) - np.eye(3)).max(axis=(-2, -1)) > _ROUNDED
    if off.any():
        poses[off, :3, :3] = Rotation.from_matrix(rotations[off]).as_matrix()
    poses[..., 3, :] = 0.0, 0.0, 0.0, 1.0
    return poses


def look_along(
    position: np.ndarray,  # [3] world
    direction: np.ndarray,  # [3] world, any length > 0
) -> np.ndarray:  # [4, 4] world_from_camera
    """Return the pose of a camera at ``position`` that looks along ``direction`` without roll (image up = world up).

    For a vertical direction, where roll is undefined, the image's right is world +x.
    """
    forward = np.asarray(direction, dtype=np.float64)
    length = np.linalg.norm(forward)
    if not length > 0:
        raise ValueError(f"direction must have a length above 0, got {direction}")
    forward = forward / length
    right = np.array([forward[1], -forward[0], 0.0])  # forward x world up
    right = right / np.linalg.norm(right) if np.linalg.norm(right) > 1e-9 else np.array([1.0, 0.0, 0.0])
    world_from_camera = np.eye(4)
    world_from_camera[:3, 0] = right
    world_from_camera[:3, 1] = np.cross(forward, right)
    world_from_camera[:3, 2] = forward
    world_from_camera[:3, 3] = position
    return world_from_camera


def rotation_angle(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the angles in radians between the rotations of two (stacks of) transforms ``[..., 4, 4]``."""
    # The Frobenius norm of the difference of two rotations by angle a is sqrt(8) sin(a / 2). It is accurate for small
    # angles, where arccos of the trace is not.
    difference = np.linalg.norm(first[..., :3, :3] - second[..., :3, :3], axis=(-2, -1))
    return 2.0 * np.arcsin(np.clip(difference / np.sqrt(8.0), 0.0, 1.0))


def se3_exp(tangent: np.ndarray) -> np.ndarray:
    """Return the 4x4 rigid transform exp([rho, theta]), the exponential map of SE(3).

    ``tangent`` [6] holds rho (metres) and the rotation vector theta (radians).
    """
    rho, theta = np.asarray(tangent[:3], dtype=np.float64), np.asarray(tangent[3:], dtype=np.float64)
    angle = np.linalg.norm(theta)
    hat = np.array([[0, -theta[2], theta[1]], [theta[2], 0, -theta[0]], [-theta[1], theta[0], 0]])
    if angle < 1e-8:
        left_jacobian = np.eye(3) + 0.5 * hat
    else:
        left_jacobian = (
            np.eye(3) + (1 - np.cos(angle)) / angle**2 * hat + (angle - np.sin(angle)) / angle**3 * hat @ hat
        )
    transform = np.eye(4)
    transform[:3, :3] = Rotation.from_rotvec(theta).as_matrix()
    transform[:3, 3] = left_jacobian @ rho
    return transform
