"""Provide policies. A policy chooses the next view from the observation and its own state.

Each planner is a folder. `policy.py` holds the policy; `features.py` and `sources.py` hold the features and candidate
sources that only this planner uses. `POLICIES`, `FEATURES` and `SOURCES` find them there, so that no list names them.
Import a planner's class from its folder: ``from activestructure_gym.policies.naruto import Naruto``.

`policy.py` and its imports never read the map; `features.py` and `sources.py` may.
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
