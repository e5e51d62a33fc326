"""Sample candidate views, test which planes each would see, and measure unmapped parts in panoramas.

The pool is the same for every policy. No code in this room may read ground truth.
"""

from activestructure_gym.views.candidates import CandidatePool, CandidateTable, ViewConfig
from activestructure_gym.views.visibility import visible_planes

__all__ = [
    "CandidatePool",
    "CandidateTable",
    "ViewConfig",
    "visible_planes",
]
