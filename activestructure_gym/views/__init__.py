"""Candidate views: the pool, the planes each view would see, and panoramas of missing parts.

The pool is the same for every policy; a feature turns the current map into one number per candidate. Nothing in this
room may look at ground truth.
"""

from activestructure_gym.views.candidates import CandidatePool, CandidateTable, ViewConfig
from activestructure_gym.views.visibility import visible_planes

__all__ = [
    "CandidatePool",
    "CandidateTable",
    "ViewConfig",
    "visible_planes",
]
