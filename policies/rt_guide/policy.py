"""RT-GuIDE ([rt_guide]): first the region that is worth its way, then the view in it where most still moves."""

from __future__ import annotations

import numpy as np

from activestructure_gym.policies.base import POLICIES, Observation, best_valid, without_revisits
from activestructure_gym.policies.greedy import Planner
from activestructure_gym.policies.native_settings import NativeSettings

_NOTHING = -1e6  # below the logarithm of anything above 0, with any way


@POLICIES.register("rt_guide")
class RTGuide(Planner):
    """Region: argmax Omega / e^d, d the way in metres to its nearest view; view in it: argmax xi.

    With the shared travel term there are no regions: xi, counted from the lowest one on offer, times the factor of all.
    Revisits are no candidates of it.
    """

    criterion = "Gaussians that still move, against those that do not"
    travel_term = "region by uncertainty / e^metres"
    source = "Tao et al., RT-GuIDE, RA-L 2025"
    required_features = ("rt_guide",)
    # Goals and views of a robot that drives; the lattice stands for its motion primitives (own choice).
    native_settings = NativeSettings(stages=(("floor?spacing_m=0.5&yaws=8&rows=512",),), candidates=512)

    def act(self, observation: Observation) -> int:
        """The best view of the best region; the nearest region where no Gaussian has moved."""
        observation = without_revisits(observation)
        candidates = self.candidates(observation)
        valid = candidates.valid
        xi, region, cuboid = candidates.feature("rt_guide").astype(np.float64).T
        if self.travel == "shared" or not valid.any():
            gain = xi - xi[valid].min() if valid.any() else xi
            choice = best_valid(self.scores(gain, observation), observation)
        else:
            length = candidates.path_length.astype(np.float64)
            # As logarithms: e^d of a long way is no number.
            worth = np.where(region > 0, np.log(np.maximum(region, 1e-300)), _NOTHING) - length
            inside = valid & (cuboid == cuboid[best_valid(worth, observation)])
            choice = int(np.argmax(np.where(inside, xi, -np.inf)))
        self._trace = {"rt_guide": float(xi[choice]), "region": float(region[choice]), "cuboid": int(cuboid[choice])}
        return choice
