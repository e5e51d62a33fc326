"""ActiveGS ([active_gs]): unexplored space and unsure surface, less the share of the way."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from activestructure_gym.policies.base import POLICIES, Observation, without_revisits
from activestructure_gym.policies.greedy import Greedy
from activestructure_gym.policies.native_settings import NativeSettings


@POLICIES.register("active_gs")
class ActiveGS(Greedy):
    """score = U / sum U - 0.5 L / sum L over the valid candidates.

    U is the gain, L the path length in metres. Where nothing has a gain all U count the same, and the nearest view is
    taken; the original then draws scores by lot. Revisits are no candidates of it.
    """

    criterion = "unexplored voxels in sight, surface without confidence"
    travel_term = "share of the path length subtracted"
    source = "Jin et al., ActiveGS, RA-L 2025"
    required_features = ("confidence",)
    native_settings = NativeSettings(
        stages=(("roi?rows=30", "around?rows=70"),),
        candidates=100,
        goal_keyframes=True,
        budget="300 s at 1 m/s, 512 x 512 at 60 degrees",
    )
    way: ClassVar[float] = 0.5  # weight of the path's share

    def act(self, observation: Observation) -> int:
        """The valid row with the highest score; the trace says how far it is where that is no factor."""
        choice = super().act(without_revisits(observation))
        if self.travel == "native":
            gain = self.required_features[0]
            length = float(self.candidates(observation).path_length[choice])
            self._trace = {gain: self._trace[gain], "path_length": length}
        return choice

    def native_scores(self, gain: np.ndarray, observation: Observation) -> np.ndarray:
        """The difference of the two shares."""
        candidates = self.candidates(observation)
        valid, length = candidates.valid, candidates.path_length.astype(np.float64)
        sums = max(float(gain[valid].sum()), 1e-300), max(float(length[valid].sum()), 1e-12)
        return gain.astype(np.float64) / sums[0] - self.way * length / sums[1]
