"""Define R3-RECON ([r3_recon]): score unexplored space and surface that cannot be rendered well from a side."""

from __future__ import annotations

from activestructure_gym.policies.active_gs.policy import ActiveGS
from activestructure_gym.policies.base import POLICIES
from activestructure_gym.policies.native_settings import NativeSettings


@POLICIES.register("r3_recon")
class R3Recon(ActiveGS):
    """Choose argmax of U / sum U - 0.5 L / sum L, as ActiveGS does; U is the feature `r3_recon`, L the path length."""

    criterion = "visible unexplored voxels, surface that cannot be rendered well from this side"
    source = "Jin et al., R3-RECON, arXiv 2601.07484"
    required_features = ("r3_recon",)
    # The views face frontier voxels only, unlike ActiveGS's (`use_confidence: false` in [r3_recon, code]).
    native_settings = NativeSettings(
        stages=(("frontier_facing?rows=30", "around?rows=70"),),
        candidates=100,
        goal_keyframes=True,
        iterations=10,
        budget="300 s at 1 m/s, 512 x 512 at 60 degrees, 10 iterations",
    )
