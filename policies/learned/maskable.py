"""Adapt the candidate-set network to sb3-contrib's MaskablePPO: ``MaskablePPO(MaskableCandidatePolicy, env)``.

MaskablePPO accepts only subclasses of its own policies, and needs the ``action_masks()`` that the environments have.
"""

from __future__ import annotations

from sb3_contrib.common.maskable.policies import MaskableMultiInputActorCriticPolicy

from activestructure_gym.policies.learned.sb3 import CandidateHeads


class MaskableCandidatePolicy(CandidateHeads, MaskableMultiInputActorCriticPolicy):
    """Provide actor and critic of the candidate-set network to MaskablePPO, as `CandidatePolicy` does to PPO.

    The network masks rows without a candidate; the masks of MaskablePPO or of a wrapper can only mask more rows.
    """
