"""What going to a view would truly show: the surface that the keyframes of the way see first.

Ground truth, for references and benchmarks; nothing here reaches an observation.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from activestructure_gym.evaluation.protocols import CameraPath
from activestructure_gym.evaluation.protocols.sight import seen_by_keyframes
from activestructure_gym.ground_truth import GroundTruth
from activestructure_gym.ground_truth.observable import SIGHT_MARGIN
from activestructure_gym.motion import Way
from activestructure_gym.reconstruction import Reconstruction

_SAMPLES = 4000  # of the observable surface, spread evenly


def whole_pool(reconstruction: Reconstruction, most: int | None = None) -> np.ndarray:  # [n, 4, 4] world_from_camera
    """Every view of the pool that can be reached now, no matter how many a table holds; at most ``most``, drawn."""
    pool = copy.copy(reconstruction.pool)
    rows = pool.positions.shape[0] * pool.config.directions if most is None else most
    pool.config = replace(pool.config, max_candidates=max(rows, pool.config.max_revisits + 1))
    nothing = np.zeros((0, 4, 4))
    table = pool.offer(reconstruction.volume, reconstruction.distances, reconstruction.decisions, nothing)
    return table.world_from_camera[:rows]


class TrueSurface:
    """The observable surface of the scene of an episode, and which of it is still to be seen.

    By lines of sight from the keyframes' true poses, as `observed` of the standard protocol, not by the sensor's depth.
    """

    def __init__(self, truth: GroundTruth, samples: int = _SAMPLES) -> None:
        surface = truth.observable_surface
        self._scene = truth.scene
        self.points = surface.points[:: max(1, len(surface.points) // samples)]  # [S, 3]
        self.area = surface.area / max(1, len(self.points))  # m^2 of a point
        self._counted = 0  # keyframes
        self.seen = np.zeros(len(self.points), dtype=bool)

    def follow(self, reconstruction: Reconstruction) -> None:
        """Count the keyframes that the episode has taken since the last call."""
        new = reconstruction.keyframe_indices[self._counted :]
        if new:
            poses = np.stack([reconstruction.trajectory[index] for index in new])
            waiting = np.flatnonzero(~self.seen)
            self.seen[waiting] = self._shown(reconstruction, poses, self.points[waiting])
            self._counted += len(new)

    def new_area(self, reconstruction: Reconstruction, keyframes: np.ndarray) -> float:  # [K, 4, 4] -> m^2
        """The area that these keyframes together would show and none has shown yet."""
        return self.area * int(self._shown(reconstruction, keyframes, self.points[~self.seen]).sum())

    def rates(self, reconstruction: Reconstruction, taken: Sequence[Way | None]) -> np.ndarray:  # [n] m^2 per frame
        """Newly observed area by frame paid, of every way; 0 where there is none."""
        found = [0.0 if w is None else self.new_area(reconstruction, w.keyframes) / max(w.frames, 1) for w in taken]
        return np.array(found, np.float64)

    def _shown(self, reconstruction: Reconstruction, poses: np.ndarray, points: np.ndarray) -> np.ndarray:
        sensor = reconstruction.config.sensor
        path = CameraPath(sensor.camera, poses[0], poses, sensor.max_range)
        return seen_by_keyframes(points, path, self._scene, SIGHT_MARGIN)
