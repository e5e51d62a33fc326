"""R3-RECON as a policy ([r3_recon])."""

from __future__ import annotations

from activestructure_gym.policies.active_gs.policy import ActiveGS
from activestructure_gym.policies.base import POLICIES
from activestructure_gym.policies.native_settings import NativeSettings


@POLICIES.register("r3_recon")
class R3Recon(ActiveGS):
    """score = U / sum U - 0.5 L / sum L, as ActiveGS, from which it is made; U is what cannot be rendered well yet."""

    criterion = "unexplored voxels in sight, surface that could not be rendered from this side"
    source = "Jin et al., R3-RECON, arXiv 2601.07484"
    required_features = ("r3_recon",)
    # Frontier voxels alone are its regions of interest (`use_confidence: false`, [r3_recon, code]).
    native_settings = NativeSettings(
        stages=(("frontier_facing?rows=30", "around?rows=70"),),
        candidates=100,
        goal_keyframes=True,
        iterations=10,
        budget="300 s at 1 m/s, 512 x 512 at 60 degrees, 10 iterations",
    )
