"""Provide trained policies: a small network over the set of candidates, named ``learned:CHECKPOINT``.

Importing this package is fast. The first decision loads torch, `CandidatePolicy` loads stable-baselines3, and
`MaskableCandidatePolicy` loads sb3-contrib, which is not a dependency.
"""

from typing import Any

from activestructure_gym.policies.learned.config import USED_KEYS
from activestructure_gym.policies.learned.policy import SHIPPED, Learned, learned_from

__all__ = [
    "SHIPPED",
    "USED_KEYS",
    "CandidatePolicy",
    "Learned",
    "MaskableCandidatePolicy",
    "learned_from",
    "with_used_keys",
]


def __getattr__(name: str) -> Any:
    if name in ("CandidatePolicy", "with_used_keys"):
        from activestructure_gym.policies.learned import sb3

        return getattr(sb3, name)
    if name == "MaskableCandidatePolicy":
        from activestructure_gym.policies.learned.maskable import MaskableCandidatePolicy

        return MaskableCandidatePolicy
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
