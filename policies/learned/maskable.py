"""The candidate-set network inside sb3-contrib's MaskablePPO, which takes policies of its own kind alone.

``MaskablePPO(MaskableCandidatePolicy, env)``; the environments offer the ``action_masks()`` it asks for.
"""

from __future__ import annotations

from sb3_contrib.common.maskable.policies import MaskableMultiInputActorCriticPolicy

from activestructure_gym.policies.learned.sb3 import CandidateHeads


class MaskableCandidatePolicy(CandidateHeads, MaskableMultiInputActorCriticPolicy):
    """Actor and critic of the candidate-set network, as `CandidatePolicy` has them.

    A row without a candidate is ruled out by the network and by the masks that MaskablePPO brings; those of a wrapper
    may close more rows, and open none.
    """
