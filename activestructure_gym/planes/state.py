"""Hold the result of the last assessment of the Plane Scene Graph: arrays with one row per plane."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from activestructure_gym.planes.quality import Quality
from activestructure_gym.planes.surprise import Surprise


@dataclass(frozen=True)
class GraphState:
    """Hold N planes and their relations. Row k of every array is the plane with id ``ids[k]``; ids increase."""

    ids: np.ndarray  # [N] int64
    normals: np.ndarray  # [N, 3] unit, world, towards the side from which the plane is observed
    offsets: np.ndarray  # [N] metres; normal . x + offset = 0
    centroids: np.ndarray  # [N, 3] metres, world
    areas: np.ndarray  # [N] m^2 of seen surface
    point_counts: np.ndarray  # [N] int64, seen cells with a measured point
    observations: np.ndarray  # [N] int64, number of keyframes that observed the plane
    weights: np.ndarray  # [N, N] Eq. 4, small = reliable; defined for all pairs
    edges: np.ndarray  # [N, N] bool, pairs of planes with an edge
    tree: np.ndarray  # [N, N] bool, edges of the minimum spanning forest
    betweenness: np.ndarray  # [N] betweenness centrality in the spanning forest
    structural: np.ndarray  # [N] bool, structural planes V_S of Eq. 5
    quality: Quality  # scores s_1 .. s_8 of the modes and quality q, Eqs. 6 and 7
    surprise: Surprise  # indicators phi^c, phi^r, phi^g and surprise Phi, Eqs. 8 and 9
    deficit: np.ndarray  # [N] information deficit gamma, Eq. 10

    def __len__(self) -> int:
        return len(self.ids)
