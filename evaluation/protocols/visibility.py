"""Test which points of the true surface were visible in the keyframes of an episode, by lines of sight."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from activestructure_gym.geometry import invert_rigid, transform_points
from activestructure_gym.ground_truth.observable import first_in_sight

if TYPE_CHECKING:
    from activestructure_gym.evaluation.protocols.base import CameraPath
    from activestructure_gym.geometry import PinholeCamera
    from activestructure_gym.scenes import Scene

_RAYS = 1 << 17  # number of lines of sight that are tested together: 3 MB


def seen_by_keyframes(
    points: np.ndarray,  # [S, 3] metres, on the surface
    path: CameraPath,
    scene: Scene,
    margin: float,  # metres in front of a point in which the mesh does not block the line of sight
) -> np.ndarray:  # [S] bool
    """Return which points were visible in at least one keyframe: in the image, within range, and not occluded.

    ``path`` holds the camera, its range and the poses of the keyframes; the mesh of ``scene`` occludes. Lines of sight
    end exactly at the points, so slanted surfaces are not missed between pixels. Both sides of a surface count as
    visible, as for the observable surface.
    """
    camera_from_world = invert_rigid(path.keyframes)

    def in_view(index: int, positions: np.ndarray) -> np.ndarray:
        return _in_view(path.camera, path.max_range, camera_from_world[index], positions)

    return first_in_sight(scene, points, path.keyframes[:, :3, 3], in_view, margin) >= 0


def seen_on_paths(
    points: np.ndarray,  # [S, 3] metres, on the surface
    paths: Sequence[np.ndarray],  # [K, 4, 4] each: poses of keyframes, world_from_camera; K may be 0
    camera: PinholeCamera,
    max_range: float,  # metres
    scene: Scene,
    margin: float,  # metres, as in `seen_by_keyframes`
) -> np.ndarray:  # [len(paths), S] bool
    """Return for each of many paths what `seen_by_keyframes` does; poses that paths share are tested once."""
    rows: dict[bytes, int] = {}  # of each distinct pose
    own = [[rows.setdefault(pose.tobytes(), len(rows)) for pose in np.asarray(path, np.float64)] for path in paths]
    poses = np.frombuffer(b"".join(rows), np.float64).reshape(-1, 4, 4)
    seen = _seen_by_each(np.asarray(points, np.float32), poses, camera, max_range, scene, margin)
    found = np.zeros((len(paths), seen.shape[1]), np.uint8)
    for row, poses_of in enumerate(own):
        found[row] = np.bitwise_or.reduce(seen[poses_of], axis=0)  # 0 for no pose
    return np.unpackbits(found, axis=1, count=len(points)).view(bool)


def _seen_by_each(
    points: np.ndarray,  # [S, 3] float32
    poses: np.ndarray,  # [K, 4, 4]
    camera: PinholeCamera,
    max_range: float,
    scene: Scene,
    margin: float,
) -> np.ndarray:  # [K, ceil(S / 8)] uint8
    """Return which points are visible in each pose, as bits. Lines of sight of several poses are cast together."""
    seen = np.zeros((len(poses), (len(points) + 7) // 8), np.uint8)
    eyes, camera_from_world = poses[:, :3, 3].astype(np.float32), invert_rigid(poses)
    waiting = list[np.ndarray]()  # points in view of the poses before ``pose`` that are not tested yet
    for pose in range(len(poses)):
        waiting.append(np.flatnonzero(_in_view(camera, max_range, camera_from_world[pose], points)))
        if pose + 1 < len(poses) and sum(map(len, waiting)) < _RAYS:
            continue
        first = pose + 1 - len(waiting)
        rows = np.repeat(np.arange(len(waiting)), [len(one) for one in waiting])
        inside = np.concatenate(waiting)
        clear = ~scene.raycaster.occluded(eyes[first + rows], points[inside], margin=margin)
        table = np.zeros((len(waiting), len(points)), bool)
        table[rows[clear], inside[clear]] = True
        seen[first : pose + 1] = np.packbits(table, axis=1)
        waiting.clear()
    return seen


def _in_view(
    camera: PinholeCamera, max_range: float, camera_from_world: np.ndarray, positions: np.ndarray
) -> np.ndarray:  # [S] bool
    """Return which positions are in the image and within range."""
    points = transform_points(camera_from_world, positions)
    return camera.in_image(points) & (points[:, 2] <= max_range)
