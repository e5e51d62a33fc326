"""R3-RECON as a policy ([r3_recon])."""

from __future__ import annotations

from activestructure_gym.policies.active_gs import ActiveGS
from activestructure_gym.policies.base import POLICIES


@POLICIES.register("r3_recon")
class R3Recon(ActiveGS):
    """score = U / sum U - 0.5 L / sum L, as ActiveGS, from which it is made; U is what cannot be rendered well yet."""

    decides_by = "unexplored voxels in sight, surface that could not be rendered from this side"
    source = "Jin et al., R3-RECON, arXiv 2601.07484"
    required_gains = ("r3_recon",)
