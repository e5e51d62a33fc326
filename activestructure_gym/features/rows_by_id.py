"""Keep additional numbers per Gaussian in the order of the map, which adds, removes and moves Gaussians."""

from __future__ import annotations

import numpy as np

from activestructure_gym.mapping.gaussian_map import GaussianMap


class RowsById:
    """Keep one row of numbers per Gaussian; `follow` puts the rows into the present order of the map's Gaussians.

    New Gaussians get a row of zeros, and rows of removed Gaussians are dropped. Rows are matched with Gaussians by
    `GaussianMap.ids`. The cost of `follow` is proportional to the number of Gaussians that were added, removed or moved
    since the last call.
    """

    def __init__(self, gaussians: GaussianMap, columns: int) -> None:
        self._map = gaussians
        self._values = np.zeros((0, columns))  # [capacity, columns]
        self._ids = np.zeros(0, dtype=np.int64)  # [capacity], id of the Gaussian of each row
        self._rows = np.zeros(0, dtype=np.int32)  # row of each id; -1 for none
        self._count = 0

    @property
    def values(self) -> np.ndarray:  # [N, columns] float64
        """Return a writable view of the rows, in the order of the last call of `follow`; valid until the next call."""
        return self._values[: self._count]

    def rows_of(self, ids: np.ndarray) -> np.ndarray:  # [S] int64 -> [S] int32
        """Return the row index of each Gaussian id as of the last call of `follow`; -1 if the Gaussian was removed.

        Every id must have been in the map at some call of `follow`.
        """
        return self._rows[ids]

    def follow(self) -> np.ndarray:  # [N, columns] float64
        """Put the rows into the present order of the map's Gaussians, and return `values`."""
        gaussians, before = self._map, self._count
        count = gaussians.count
        if len(self._values) < count:
            values = np.zeros((gaussians.capacity, self._values.shape[1]))
            ids = np.full(gaussians.capacity, -1, dtype=np.int64)
            values[:before], ids[:before] = self._values[:before], self._ids[:before]
            self._values, self._ids = values, ids
        if len(self._rows) < gaussians.next_id:
            rows_of = np.full(gaussians.next_id + gaussians.next_id // 2, -1, dtype=np.int32)
            rows_of[: len(self._rows)] = self._rows
            self._rows = rows_of
        ids = gaussians.ids[:count]
        shared = min(before, count)
        moved = np.flatnonzero(ids[:shared] != self._ids[:shared])
        changed = np.concatenate([moved, np.arange(shared, count)])
        sources = self._rows[ids[changed]]
        found = np.where(sources[:, None] >= 0, self._values[sources], 0.0)
        gone = np.concatenate([self._ids[moved], self._ids[shared:before]])
        self._rows[gone] = -1
        self._rows[ids[changed]] = changed
        self._values[changed], self._ids[changed] = found, ids[changed]
        self._count = count
        return self.values
