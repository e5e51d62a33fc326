"""Sample candidate views, test which planes each would see, and measure unmapped regions in panoramas.

All policies choose from the same pool of candidates. No code in this package may read ground truth.
"""

from activestructure_gym.views.candidates import CandidatePool, CandidateTable, ViewConfig
from activestructure_gym.views.given_views import GivenViews, without_overlap
from activestructure_gym.views.visibility import visible_planes

__all__ = [
    "CandidatePool",
    "CandidateTable",
    "GivenViews",
    "ViewConfig",
    "visible_planes",
    "without_overlap",
]
