"""Define ActiveGS ([active_gs]): score unexplored space and uncertain surface, minus path length."""

from __future__ import annotations

import numpy as np

from activestructure_gym.policies.base import POLICIES, Observation, without_revisits
from activestructure_gym.policies.greedy import Greedy
from activestructure_gym.policies.native_settings import NativeSettings

# The camera of ActiveGS and R3-RECON is square with 60 degrees and depth up to 5 m; theirs has 512 x 512 pixels.
CAMERA_60 = {
    "sensor.width": 240, "sensor.height": 240, "sensor.horizontal_fov_deg": 60.0, "sensor.max_range": 5.0
}  # fmt: skip


@POLICIES.register("active_gs")
class ActiveGS(Greedy):
    """Choose argmax of U / sum U - 0.5 L / sum L over the valid candidates.

    U is the gain, L the path length in metres. If no view has a gain, the nearest is chosen; the original then draws
    random scores. Revisits are not candidates.
    """

    criterion = "visible unexplored voxels, surface without confidence"
    travel_term = "share of the path length subtracted"
    source = "Jin et al., ActiveGS, RA-L 2025"
    required_features = ("confidence",)
    native_settings = NativeSettings(
        stages=(("roi?rows=30", "around?rows=70"),),
        candidates=100,
        goal_keyframes=True,
        changes=CAMERA_60,
        budget="300 s at 1 m/s, 512 x 512 at 60 degrees",
    )

    def act(self, observation: Observation) -> int:
        """Return the valid row with the highest score; revisits are valid only if there are no other views."""
        choice = super().act(without_revisits(observation))
        if self.travel == "native":
            gain = self.required_features[0]
            length = float(self.candidates(observation).path_length[choice])
            self._trace = {gain: self._trace[gain], "path_length": length}
        return choice

    def path_weight(self, observation: Observation) -> float:
        """Return the weight of L / sum L."""
        return 0.5

    def native_scores(self, gain: np.ndarray, observation: Observation) -> np.ndarray:
        """Return the score for the gain U and the path length L (m); the sums are over valid rows."""
        share, path = self._shares(gain, observation)
        return share + path

    def score_terms(self, name: str, gain: np.ndarray, observation: Observation) -> dict[str, np.ndarray]:
        """Return the terms of the scores: both shares, or with the shared travel term the gain and the factor."""
        if self.travel == "shared":
            return super().score_terms(name, gain, observation)
        return dict(zip((f"{name} share", "path share"), self._shares(gain, observation)))

    def _shares(self, gain: np.ndarray, observation: Observation) -> tuple[np.ndarray, np.ndarray]:  # [K], [K]
        """Return U / sum U and -w L / sum L, where w is the path weight."""
        candidates = self.candidates(observation)
        valid, length = candidates.valid, candidates.path_length.astype(np.float64)
        sums = max(float(gain[valid].sum()), 1e-300), max(float(length[valid].sum()), 1e-12)
        return gain.astype(np.float64) / sums[0], -(self.path_weight(observation) * length / sums[1])
