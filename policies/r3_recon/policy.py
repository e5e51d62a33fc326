"""Define R3-RECON ([r3_recon]): score unexplored space and surface that cannot be rendered well from a side."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from activestructure_gym.policies.active_gs.policy import ActiveGS
from activestructure_gym.policies.base import POLICIES, Observation, without_revisits

HERE_M = 1e-6  # metres; views at most this far from the agent are not candidates


@POLICIES.register("r3_recon")
class R3Recon(ActiveGS):
    """Choose argmax of U / sum U - w L / sum L; U is the feature `r3_recon`, L the path length.

    w is the largest mean of 1 - R over the candidates, where R is the renderability of the surface voxels that a
    candidate sees. Views at the agent's position are not candidates.
    """

    criterion = "visible unexplored voxels, surface that cannot be rendered well from this side"
    source = "Jin et al., R3-RECON, arXiv 2601.07484"
    required_features = ("r3_recon",)
    # The views face frontier voxels only, unlike ActiveGS's (`use_confidence: false` in [r3_recon, code]).
    native_settings = replace(ActiveGS.native_settings, stages=(("frontier_facing?rows=30", "around?rows=70"),))

    def act(self, observation: Observation) -> int:
        """Return the valid row with the highest score; turns in place are valid only if there are no other views."""
        observation = without_revisits(observation)
        candidates = self.candidates(observation)
        away = candidates.valid & (candidates.path_length > HERE_M)
        return super().act({**observation, "action_mask": away.astype(np.int8)} if away.any() else observation)

    def path_weight(self, observation: Observation) -> float:
        """Return the largest mean of 1 - R over the valid rows."""
        candidates = self.candidates(observation)
        return float(candidates["r3_recon_mean_loss"][candidates.valid].max(initial=0.0))
