"""Who chooses the next view. A policy is a pure function of the observation and its own state."""

from activestructure_gym.policies.activestructure import (
    LADDER,
    ActiveStructure,
    ActiveStructureA,
    ActiveStructureB,
    ActiveStructureC,
    ActiveStructureD,
)
from activestructure_gym.policies.base import POLICIES, Policy, travel_discount
from activestructure_gym.policies.greedy import Greedy
from activestructure_gym.policies.hole_area import HoleArea
from activestructure_gym.policies.pixel_only import PixelOnly
from activestructure_gym.policies.random import Random

__all__ = [
    "LADDER",
    "POLICIES",
    "ActiveStructure",
    "ActiveStructureA",
    "ActiveStructureB",
    "ActiveStructureC",
    "ActiveStructureD",
    "Greedy",
    "HoleArea",
    "PixelOnly",
    "Policy",
    "Random",
    "travel_discount",
]
