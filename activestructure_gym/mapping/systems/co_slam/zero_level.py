"""Convert the surface of a distance field to Gaussians: one disk where an edge of a grid crosses the surface."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from activestructure_gym.geometry import invert_rigid, transform_points
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.geometry.rotations import quaternions
from activestructure_gym.mapping.gaussian_map import COLOR, LOG_SCALE, MEAN, OPACITY_LOGIT, QUATERNION, ROWS


class Crossings(NamedTuple):
    """Hold n points where edges of a grid cross the surface. They are the vertices of a marching-cubes mesh."""

    points: np.ndarray  # [n, 3] metres, world
    normals: np.ndarray  # [n, 3] unit, towards positive distances


class VertexGrid:
    """Hold the vertices of a cubic grid in a box, and a mask of the vertices that keyframes have observed."""

    def __init__(self, bounds: np.ndarray, step: float) -> None:  # [2, 3] metres, metres between vertices
        self.step, self.low = step, np.asarray(bounds[0], dtype=np.float64)
        cells = np.ceil((np.asarray(bounds[1]) - self.low) / step - 1e-9).astype(int)
        self.shape = tuple(int(count) + 1 for count in np.maximum(cells, 1))
        self.seen = np.zeros(self.shape, dtype=bool)

    def points(self, index: np.ndarray | None = None) -> np.ndarray:  # flat indices [n] (None: all) -> [n, 3]
        """Return the world positions of vertices in metres."""
        index = np.arange(self.seen.size) if index is None else index
        return self.low + self.step * np.stack(np.unravel_index(index, self.shape), axis=1)

    def observe(self, frame: Frame, behind: float) -> None:
        """Mark the vertices that are in view of a keyframe and at most ``behind`` metres behind its measured depth."""
        left = np.flatnonzero(~self.seen)
        points = transform_points(invert_rigid(frame.world_from_camera), self.points(left))
        camera, z = frame.camera, points[:, 2]
        ahead = np.flatnonzero(z > 0)
        u = np.floor(points[ahead, 0] / z[ahead] * camera.fx + camera.cx)
        v = np.floor(points[ahead, 1] / z[ahead] * camera.fy + camera.cy)
        inside = (u >= 0) & (v >= 0) & (u < camera.width) & (v < camera.height)
        ahead = ahead[inside]
        measured = frame.depth[v[inside].astype(int), u[inside].astype(int)]
        self.seen.reshape(-1)[left[ahead[(measured > 0) & (z[ahead] <= measured + behind)]]] = True

    def crossings(self, values: np.ndarray) -> Crossings:  # distances at all vertices; unobserved ones are not used
        """Return the points on grid edges where the distance changes sign between two observed vertices."""
        slopes = _slopes(values, self.seen)
        points, normals = [np.zeros((0, 3))], [np.zeros((0, 3))]
        for axis in range(3):
            here, there = ([slice(None)] * 3 for _ in range(2))
            here[axis], there[axis] = slice(None, -1), slice(1, None)
            low, high = tuple(here), tuple(there)
            cut = self.seen[low] & self.seen[high] & ((values[low] > 0) != (values[high] > 0))
            index = np.stack(np.nonzero(cut), axis=1)
            first, second = values[low][cut], values[high][cut]
            share = (first / (first - second))[:, None]
            along = np.zeros(3)
            along[axis] = 1.0
            points.append(self.low + self.step * (index + share * along))
            normals.append(slopes[low][cut] * (1.0 - share) + slopes[high][cut] * share)
        normal = np.concatenate(normals)
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        normal = np.where(length > 0, normal / np.maximum(length, 1e-30), [0.0, 0.0, 1.0])
        return Crossings(np.concatenate(points), normal)


def _slopes(values: np.ndarray, seen: np.ndarray) -> np.ndarray:  # [X, Y, Z], [X, Y, Z] bool -> [X, Y, Z, 3]
    """Return the gradient of ``values`` per grid step, by differences with the observed neighbours on both sides.

    ``seen`` marks observed vertices. A component without observed neighbours is 0. Unobserved vertices have no valid
    value, and behind a slanted surface they are one or two steps away.
    """
    slopes = np.zeros((*values.shape, 3))
    for axis in range(3):
        here, there = ([slice(None)] * 3 for _ in range(2))
        here[axis], there[axis] = slice(None, -1), slice(1, None)
        low, high = tuple(here), tuple(there)
        both = seen[low] & seen[high]
        difference = np.where(both, values[high] - values[low], 0.0)
        total, sides = slopes[..., axis], np.zeros(values.shape)
        for side in (low, high):
            total[side] += difference
            sides[side] += both
        total /= np.maximum(sides, 1.0)
    return slopes


def disks(
    crossings: Crossings,
    colors: np.ndarray,  # [n, 3]
    sigma: float,  # metres, in-plane standard deviation
    *,
    thickness: float,  # standard deviation along the normal / ``sigma``
    opacity: float,
) -> np.ndarray:  # [14, n] float32, a block for `GaussianMap.append`
    """Return one disk per crossing, perpendicular to the normal there."""
    count = len(crossings.points)
    block = np.empty((ROWS, count), dtype=np.float32)
    block[MEAN] = crossings.points.T
    normal = crossings.normals
    # Disks are round, so any direction perpendicular to the normal is an axis.
    helper = np.where(np.abs(normal[:, :1]) < 0.9, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    across = np.cross(normal, helper)
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-30)
    axes = np.stack([across, np.cross(normal, across), normal], axis=-1)
    block[QUATERNION] = quaternions(axes).T if count else np.zeros((4, 0))
    block[LOG_SCALE] = np.log(sigma)
    block[9] += np.log(thickness)
    block[OPACITY_LOGIT] = np.log(opacity / (1.0 - opacity))
    block[COLOR] = colors.T
    return block
