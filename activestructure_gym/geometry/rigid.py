"""Compute with rigid motions as 4x4 float64 matrices.

For interpolation and conversions use `scipy.spatial.transform.Rotation`.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

_ROUNDED = 1e-6  # largest deviation from orthonormality of a rotation that is not considered rounded


def invert_rigid(transform: np.ndarray) -> np.ndarray:
    """Return the inverse of rigid motions ``[..., 4, 4]``.

    It transposes the rotation, which is exact.
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
    """Return ``R p + t`` for each point."""
    return points @ transform[:3, :3].T + transform[:3, 3]


def unrounded(poses: np.ndarray) -> np.ndarray:
    """Return poses ``[..., 4, 4]`` with rounded rotations replaced by the nearest orthonormal ones.

    The input must be nearly rigid; the last rows become (0, 0, 0, 1). Other rotations are unchanged.
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
    right = np.array([forward[1], -forward[0], 0.0])  # forward x up
    right = right / np.linalg.norm(right) if np.linalg.norm(right) > 1e-9 else np.array([1.0, 0.0, 0.0])
    world_from_camera = np.eye(4)
    world_from_camera[:3, 0] = right
    world_from_camera[:3, 1] = np.cross(forward, right)
    world_from_camera[:3, 2] = forward
    world_from_camera[:3, 3] = position
    return world_from_camera


def rotation_angle(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the angle in radians between the rotations of two (stacks of) transforms ``[..., 4, 4]``."""
    # The Frobenius distance is accurate near 0, where arccos(trace) is not.
    difference = np.linalg.norm(first[..., :3, :3] - second[..., :3, :3], axis=(-2, -1))
    return 2.0 * np.arcsin(np.clip(difference / np.sqrt(8.0), 0.0, 1.0))


def se3_exp(tangent: np.ndarray) -> np.ndarray:
    """Return the 4x4 transform exp([rho, theta]) of a tangent vector [6] in metres and radians."""
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
