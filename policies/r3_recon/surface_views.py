"""Record which colours and directions the keyframes saw of every surface voxel of 5 cm, without the Gaussian map.

A voxel is in the record once the surface point of any pixel is in it. A keyframe with such a pixel observes the voxel
if its centre projects into the image. The observation is the colour of the pixel there, and the direction and distance
from the centre to the camera. The record holds the number of views, the mean and spread of the colours, the directions
in 64 bins, and the smallest distance. Source: [r3_recon, code].
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from activestructure_gym.geometry import fibonacci_directions
from activestructure_gym.geometry.frame import Frame

VOXEL = 0.05  # metres, side length of a surface voxel
DIRECTIONS = 64  # number of direction bins, one bit of a 64-bit word each
_HALF = 1 << 20  # number of voxels from the origin to the limit of the index along an axis, 52 km


class SurfaceViews:
    """Hold the record of the V observed surface voxels, in increasing order of their integer keys."""

    def __init__(self) -> None:
        self._keys = np.zeros(0, np.int64)
        self.centres = np.zeros((0, 3))  # [V, 3] metres, world
        self.views = np.zeros(0)  # [V] number of keyframes that saw the voxel
        self.colour = np.zeros((0, 3))  # [V, 3] mean colour, 0..1
        self.deviation = np.zeros(0)  # [V] sum of squared deviations from the mean, over the three colours
        self.directions = np.zeros(0, np.uint64)  # [V] one bit for each of `fibonacci_directions(DIRECTIONS)`
        self.nearest = np.zeros(0)  # [V] metres, smallest distance
        self._known = 0  # number of keyframes added

    @property
    def spread(self) -> np.ndarray:  # [V]
        """Return the trace of the covariance of the colours that keyframes saw of each voxel; 0 after one view."""
        return self.deviation / np.maximum(self.views - 1.0, 1.0)

    def update(self, keyframes: Sequence[Frame]) -> SurfaceViews:
        """Add the keyframes that are new since the last call to the record; return this object.

        ``keyframes`` are all keyframes, those of the last call first.
        """
        if len(keyframes) < self._known:
            raise ValueError(f"expected the {self._known} keyframes of the last call and more, got {len(keyframes)}")
        for frame in keyframes[self._known :]:
            self._add(frame)
        self._known = len(keyframes)
        return self

    def _add(self, frame: Frame) -> None:
        """Add the colours, directions and distances of one keyframe to the record of the voxels that it sees."""
        measured = frame.depth > 0
        pose = frame.world_from_camera.astype(np.float64)
        points = frame.camera.backproject(frame.depth)[measured] @ pose[:3, :3].T + pose[:3, 3]
        voxels = np.floor(points / VOXEL).astype(np.int64) + _HALF
        rows = self._rows_of(np.unique((voxels[:, 0] << 42) | (voxels[:, 1] << 21) | voxels[:, 2]))
        local = (self.centres[rows] - pose[:3, 3]) @ pose[:3, :3]
        ahead = local[:, 2] > 1e-6
        pixels = np.floor(frame.camera.project(local[ahead])).astype(np.int64)
        inside = ((pixels >= 0) & (pixels < [frame.camera.width, frame.camera.height])).all(axis=1)
        rows, (columns, lines) = rows[ahead][inside], pixels[inside].T
        seen = frame.rgb[lines, columns] / 255.0
        self.views[rows] += 1.0
        before = seen - self.colour[rows]
        self.colour[rows] += before / self.views[rows, None]
        self.deviation[rows] += ((seen - self.colour[rows]) * before).sum(axis=1)
        back = pose[:3, 3] - self.centres[rows]
        distance = np.maximum(np.linalg.norm(back, axis=1), 1e-8)
        nearest = (back @ fibonacci_directions(DIRECTIONS).T).argmax(axis=1).astype(np.uint64)
        self.directions[rows] |= np.uint64(1) << nearest
        self.nearest[rows] = np.minimum(self.nearest[rows], distance)

    def _rows_of(self, keys: np.ndarray) -> np.ndarray:  # [n] int64, increasing -> [n]
        """Return the row of the voxel with each key; insert a row for each voxel that is missing."""
        places = np.searchsorted(self._keys, keys)
        there = places < len(self._keys)
        there[there] = self._keys[places[there]] == keys[there]
        new, at = keys[~there], places[~there]
        corners = np.stack([new >> 42, (new >> 21) & (2 * _HALF - 1), new & (2 * _HALF - 1)], axis=1) - _HALF
        self._keys = np.insert(self._keys, at, new)
        self.centres = np.insert(self.centres, at, (corners + 0.5) * VOXEL, axis=0)
        self.views = np.insert(self.views, at, 0.0)
        self.colour = np.insert(self.colour, at, 0.0, axis=0)
        self.deviation = np.insert(self.deviation, at, 0.0)
        self.directions = np.insert(self.directions, at, np.uint64(0))
        self.nearest = np.insert(self.nearest, at, np.inf)
        return np.searchsorted(self._keys, keys)
