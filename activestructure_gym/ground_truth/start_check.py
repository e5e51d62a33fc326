"""Check a start pose given by a user, and state the reason if it is refused."""

from __future__ import annotations

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.ground_truth.regions import in_text
from activestructure_gym.ground_truth.truth import GroundTruth
from activestructure_gym.ranges import POSE_ROUNDING
from activestructure_gym.scenes.scene import Scene

_IN_THE_SURFACE = 0.01  # metres; a camera closer to a surface counts as inside it


def check_start_pose(
    truth: GroundTruth,
    world_from_camera: np.ndarray,  # [4, 4]
    body_radius: float,  # metres
) -> None:
    """Raise `InputError` unless a body of ``body_radius`` fits at the pose, in the region of free space in use.

    If the scene's own start poses have less clearance than the body radius, their smallest clearance is required
    instead.
    """
    pose = np.asarray(world_from_camera, dtype=np.float64)
    if pose.shape != (4, 4) or not np.isfinite(pose).all():
        raise InputError(f"a start pose must be a finite 4 x 4 matrix (world_from_camera), got shape {pose.shape}")
    rotation = pose[:3, :3]
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > POSE_ROUNDING or np.linalg.det(rotation) < 0:
        raise InputError("a start pose must be a rigid motion: its upper left 3 x 3 block is not a rotation")
    space, position = truth.free_space, pose[:3, 3]
    starts = space.start_poses[:, :3, 3]
    # Tolerance of a tenth of a voxel: the clearance between voxel centres is interpolated.
    required = min(body_radius, float(space.clearance_at(starts).min())) if len(starts) else body_radius
    clearance = float(space.clearance_at(position)[0])
    if clearance > 0 and clearance >= required - 0.1 * space.voxel_size:
        return
    where = f"the start pose at ({', '.join(f'{value:.2f}' for value in position)})"
    hint = ""
    if len(starts):
        nearest = starts[np.linalg.norm(starts - position, axis=1).argmin()]
        hint = f"; the nearest free start is ({', '.join(f'{value:.2f}' for value in nearest)})"
    reason = f"{clearance:.2f} m from the nearest surface, but needs {required:.2f} m"
    raise InputError(f"{where} is {reason if clearance > 0 else _reason(truth, position, required)}{hint}")


def _reason(truth: GroundTruth, position: np.ndarray, required: float) -> str:
    """Return why a position [3] (metres) is not in the free space in use, as the end of a sentence.

    ``required`` is the required clearance in metres.
    """
    low, high = truth.scene.bounds
    if (position < low).any() or (position > high).any():
        return f"outside the scene's bounds, which go from ({in_text(low)}) to ({in_text(high)})"
    regions = truth.regions
    distance = distance_to_surface(truth.scene, position)
    if distance < _IN_THE_SURFACE:
        return "inside a wall or furniture"
    found = regions.at(position)
    if found is None:
        return regions.reason(position)
    if found is regions.used:
        return f"{distance:.2f} m from the nearest surface, but needs {required:.2f} m"
    return (
        f"free, but in another region than the one in use: region {regions.number(found)} of `asg list scenes`, "
        f"{found.volume:.1f} m3; give the scene the option inside={in_text(position)} to use that region"
    )


def distance_to_surface(scene: Scene, point: np.ndarray) -> float:  # [3] metres -> metres
    """Return the distance in metres from a point to the nearest triangle of a scene."""
    from trimesh.triangles import closest_point

    corners = scene.mesh.vertices[scene.mesh.faces]  # [F, 3, 3]
    # The nearest vertex bounds the distance; only triangles whose box is closer can be nearer.
    outside = np.maximum(corners.min(axis=1) - point, 0.0) + np.maximum(point - corners.max(axis=1), 0.0)
    bound = np.linalg.norm(corners.reshape(-1, 3) - point, axis=1).min()
    near = corners[np.linalg.norm(outside, axis=1) <= bound + 1e-6].astype(np.float64)
    return float(np.linalg.norm(closest_point(near, np.tile(point, (len(near), 1))) - point, axis=1).min())
