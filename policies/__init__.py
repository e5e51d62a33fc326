"""Policies: each chooses the next view, as a pure function of the observation and its own state.

A planner is a folder: `policy.py`, the features and the candidate sources that it alone uses in `features.py` and
`sources.py`, and whatever else these need. `POLICIES`, `FEATURES` and `SOURCES` find them there, so nothing else names
it. Its class is imported from its folder, ``from activestructure_gym.policies.naruto import Naruto``.

`policy.py`, and what it imports, never reads the map; `features.py` and `sources.py` do.
"""

from activestructure_gym.policies.base import POLICIES, Policy, canonical_policy, make_policy, travel_discount
from activestructure_gym.policies.candidates import Candidates
from activestructure_gym.policies.greedy import Greedy, Planner
from activestructure_gym.policies.native_settings import NativeSettings, Setup
from activestructure_gym.policies.pairing import make_env_and_policy

__all__ = [
    "POLICIES",
    "Candidates",
    "Greedy",
    "NativeSettings",
    "Planner",
    "Policy",
    "Setup",
    "canonical_policy",
    "make_env_and_policy",
    "make_policy",
    "travel_discount",
]
