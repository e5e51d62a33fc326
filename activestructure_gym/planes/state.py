"""Hold the state of the Plane Scene Graph at its last assessment: frozen arrays, one row per plane."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from activestructure_gym.planes.quality import Quality
from activestructure_gym.planes.surprise import Surprise


@dataclass(frozen=True)
class GraphState:
    """Hold N planes and their relations. Row k of every array is the plane with id ``ids[k]``; ids ascend."""

    ids: np.ndarray  # [N] int64
    normals: np.ndarray  # [N, 3] unit, world, towards the side from which the plane is seen
    offsets: np.ndarray  # [N] metres; normal . x + offset = 0
    centroids: np.ndarray  # [N, 3] metres, world
    areas: np.ndarray  # [N] m^2
    point_counts: np.ndarray  # [N] int64, thinned points
    observations: np.ndarray  # [N] int64, number of keyframes that observed the plane
    weights: np.ndarray  # [N, N] Eq. 4, small = reliable, for all pairs
    edges: np.ndarray  # [N, N] bool, observed relations
    tree: np.ndarray  # [N, N] bool, the minimum spanning forest
    betweenness: np.ndarray  # [N] in the forest
    structural: np.ndarray  # [N] bool, V_S of Eq. 5
    quality: Quality  # s_1 .. s_8 and q, Eqs. 6 and 7
    surprise: Surprise  # phi^c, phi^r, phi^g and Phi, Eqs. 8 and 9
    deficit: np.ndarray  # [N] gamma, Eq. 10

    def __len__(self) -> int:
        return len(self.ids)
