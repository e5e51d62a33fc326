"""Define RT-GuIDE ([rt_guide]): choose a region by uncertainty and path length, then a view of moving Gaussians."""

from __future__ import annotations

import numpy as np

from activestructure_gym.policies.base import POLICIES, Observation, best_valid, without_revisits
from activestructure_gym.policies.greedy import Planner
from activestructure_gym.policies.native_settings import NativeSettings

_NOTHING = -1e6  # score of a region where no Gaussian has moved; below any other score


@POLICIES.register("rt_guide")
class RTGuide(Planner):
    """Choose the region argmax Omega / e^d, and of its views argmax xi (feature `rt_guide`).

    A region's views are those that look at it. Omega is the mean uncertainty of the region's Gaussians, and d the path
    length in metres to its nearest view. xi is the share of Gaussians in view that moved much in the last optimisation,
    minus the share that moved little. With the shared travel term there are no regions: the score is xi minus the
    lowest xi of the candidates, times the travel factor. Revisits are not candidates.
    """

    criterion = "Gaussians that still move, minus those that do not"
    travel_term = "region by uncertainty / e^metres"
    source = "Tao et al., RT-GuIDE, RA-L 2025"
    required_features = ("rt_guide",)
    # Views for a wheeled robot, as in the original; the lattice replaces motion primitives (own choice).
    native_settings = NativeSettings(stages=(("floor?spacing_m=0.5&yaws=8&rows=512",),), candidates=512)

    def act(self, observation: Observation) -> int:
        """Return the best view of the best region; the nearest region is the best if no Gaussian has moved."""
        observation = without_revisits(self.only_views(observation))
        candidates = self.candidates(observation)
        valid = candidates.valid
        xi, region, cuboid = candidates.feature("rt_guide").astype(np.float64).T
        if self.travel == "shared" or not valid.any():
            gain = xi - xi[valid].min() if valid.any() else xi
            choice = best_valid(self.scores(gain, observation), observation)
        else:
            length = candidates.path_length.astype(np.float64)
            # Logarithm of the score, since e^d overflows for a long path.
            score = np.where(region > 0, np.log(np.maximum(region, 1e-300)), _NOTHING) - length
            of_best = valid & (cuboid == cuboid[best_valid(score, observation)])
            choice = best_valid(np.where(of_best, xi, -np.inf), observation)
        self._trace = {"rt_guide": float(xi[choice]), "region": float(region[choice]), "cuboid": int(cuboid[choice])}
        return choice
