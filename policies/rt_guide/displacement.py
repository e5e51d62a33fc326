"""Measure by how much each Gaussian moved in the last mapping event that changed it, RT-GuIDE's uncertainty."""

from __future__ import annotations

import numpy as np

from activestructure_gym.mapping.gaussian_map import MEAN, GaussianMap


class Displacement:
    """Hold the displacement of each Gaussian, found by comparing the means before and after each mapping event."""

    def __init__(self, gaussians: GaussianMap) -> None:
        """Store the map, which mapping changes in place."""
        self._map = gaussians
        self._by_id = np.zeros(0, np.float32)  # metres, by id of the Gaussian
        self._ids = np.zeros(0, np.int64)
        self._means = np.zeros((3, 0), np.float32)

    def before_steps(self) -> None:
        """Store a copy of the means before the optimisation steps of a mapping event; the mapper calls this."""
        count = self._map.count
        self._ids = self._map.ids[:count].copy()
        self._means = self._map.parameters[MEAN, :count].copy()

    def after_steps(self) -> None:
        """Measure the displacement of every Gaussian that still exists after a mapping event; the mapper calls this."""
        self._extend()
        ids = self._map.ids[: self._map.count]
        column = np.full(self._map.next_id, -1, np.int32)
        column[self._ids] = np.arange(len(self._ids), dtype=np.int32)
        moved = np.linalg.norm(self._map.parameters[MEAN, : len(ids)] - self._means[:, column[ids]], axis=0)
        touched = moved > 0.0
        self._by_id[ids[touched]] = moved[touched]

    def metres(self) -> np.ndarray:  # [N] float32
        """Return how far each Gaussian moved in the last mapping event that moved it, in metres; 0 without one."""
        self._extend()
        return self._by_id[self._map.ids[: self._map.count]]

    def _extend(self) -> None:
        """Enlarge the array of displacements for the ids of new Gaussians."""
        missing = self._map.next_id - len(self._by_id)
        if missing > 0:
            spare = np.zeros(missing + self._map.next_id // 2, np.float32)
            self._by_id = np.concatenate([self._by_id, spare])
