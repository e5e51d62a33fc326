"""How far each Gaussian moved in the last mapping event that moved it: RT-GuIDE's stand-in for its uncertainty."""

from __future__ import annotations

import numpy as np

from activestructure_gym.mapping.gaussian_map import MEAN, GaussianMap


class Movement:
    """Looks at a map before and after each event; changes nothing there. Costs a copy of the means per event."""

    def __init__(self, gaussians: GaussianMap) -> None:
        self._map = gaussians
        self._by_name = np.zeros(0, np.float32)  # metres, by name of the Gaussian
        self._names = np.zeros(0, np.int64)
        self._means = np.zeros((3, 0), np.float32)

    def begin(self) -> None:
        """Before the steps of an event, after its seeding."""
        count = self._map.count
        self._names = self._map.ids[:count].copy()
        self._means = self._map.parameters[MEAN, :count].copy()

    def end(self) -> None:
        """After the steps; Gaussians may have gone, none may have come."""
        self._extend()
        names = self._map.ids[: self._map.count]
        column = np.full(self._map.named, -1, np.int32)
        column[self._names] = np.arange(len(self._names), dtype=np.int32)
        moved = np.linalg.norm(self._map.parameters[MEAN, : len(names)] - self._means[:, column[names]], axis=0)
        touched = moved > 0.0
        self._by_name[names[touched]] = moved[touched]

    def metres(self) -> np.ndarray:  # [N] float32
        """Of every Gaussian of the map; 0 for one that no event has moved since somebody looks."""
        self._extend()
        return self._by_name[self._map.ids[: self._map.count]]

    def _extend(self) -> None:
        missing = self._map.named - len(self._by_name)
        if missing > 0:
            spare = np.zeros(missing + self._map.named // 2, np.float32)
            self._by_name = np.concatenate([self._by_name, spare])
