"""Provide ActiveStructure, the planner of the paper ([activestructure]), and the variants A to E of its Table 3.

Read in this order: `information_gain` (Eqs. 11 to 14), `phases` (the three phases and their ends), `policy` (Eq. 15
and the loop). The observation contains the planes, their quality and their surprise (Eqs. 4 to 10).
"""

from activestructure_gym.policies.activestructure.information_gain import (
    GainTerms,
    PlaneView,
    Weights,
    information_gain,
)
from activestructure_gym.policies.activestructure.phases import PHASES, Phase, PhaseMachine
from activestructure_gym.policies.activestructure.policy import (
    LADDER,
    ActiveStructure,
    ActiveStructureA,
    ActiveStructureB,
    ActiveStructureC,
    ActiveStructureD,
)

__all__ = [
    "LADDER",
    "PHASES",
    "ActiveStructure",
    "ActiveStructureA",
    "ActiveStructureB",
    "ActiveStructureC",
    "ActiveStructureD",
    "GainTerms",
    "Phase",
    "PhaseMachine",
    "PlaneView",
    "Weights",
    "information_gain",
]
