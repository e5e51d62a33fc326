"""Policies: each chooses the next view, as a pure function of the observation and its own state."""

from activestructure_gym.policies.active_gs import ActiveGS
from activestructure_gym.policies.activegamer import ActiveGAMER
from activestructure_gym.policies.activeinr import ActiveINR
from activestructure_gym.policies.activepolicy import ActivePolicy
from activestructure_gym.policies.activesplat import ActiveSplat
from activestructure_gym.policies.activestructure import (
    LADDER,
    ActiveStructure,
    ActiveStructureA,
    ActiveStructureB,
    ActiveStructureC,
    ActiveStructureD,
)
from activestructure_gym.policies.aiisrfe import Aiisrfe
from activestructure_gym.policies.anm_s import AnmS
from activestructure_gym.policies.base import POLICIES, Policy, canonical_policy, make_policy, travel_discount
from activestructure_gym.policies.candidates import Candidates
from activestructure_gym.policies.fisherrf import FisherRF, FisherRFCov, FisherRFPath
from activestructure_gym.policies.frontier import Frontier
from activestructure_gym.policies.gauss_mi import GaussMI, GaussMICov
from activestructure_gym.policies.gavis import Gavis
from activestructure_gym.policies.greedy import Greedy, Planner
from activestructure_gym.policies.gs_planner import GSPlanner
from activestructure_gym.policies.hgs_planner import HGSPlanner
from activestructure_gym.policies.hole_area import HoleArea
from activestructure_gym.policies.learned import Learned
from activestructure_gym.policies.magician import Magician
from activestructure_gym.policies.naruto import Naruto
from activestructure_gym.policies.next_best_sense import NextBestSense, NextBestSenseCov
from activestructure_gym.policies.pairing import make_env_and_policy
from activestructure_gym.policies.pixel_only import PixelOnly
from activestructure_gym.policies.popgs import (
    CovTrace,
    CovTraceBlock,
    CovTraceBlockCov,
    CovTraceCov,
    InfoTrace,
    InfoTraceCov,
    LogDet,
    LogDetBlock,
    LogDetBlockCov,
    LogDetCov,
    MinEig,
    MinEigCov,
)
from activestructure_gym.policies.r3_recon import R3Recon
from activestructure_gym.policies.random import Random
from activestructure_gym.policies.rt_guide import RTGuide
from activestructure_gym.policies.schedule import Schedule, Terms
from activestructure_gym.policies.unknown_volume import UnknownVolume
from activestructure_gym.policies.unseen import Unseen
from activestructure_gym.policies.view_angle import ViewAngle

__all__ = [
    "LADDER",
    "POLICIES",
    "ActiveGAMER",
    "ActiveGS",
    "ActiveINR",
    "ActivePolicy",
    "ActiveSplat",
    "ActiveStructure",
    "ActiveStructureA",
    "ActiveStructureB",
    "ActiveStructureC",
    "ActiveStructureD",
    "Aiisrfe",
    "AnmS",
    "Candidates",
    "CovTrace",
    "CovTraceBlock",
    "CovTraceBlockCov",
    "CovTraceCov",
    "FisherRF",
    "FisherRFCov",
    "FisherRFPath",
    "Frontier",
    "GSPlanner",
    "GaussMI",
    "GaussMICov",
    "Gavis",
    "Greedy",
    "HGSPlanner",
    "HoleArea",
    "InfoTrace",
    "InfoTraceCov",
    "Learned",
    "LogDet",
    "LogDetBlock",
    "LogDetBlockCov",
    "LogDetCov",
    "Magician",
    "MinEig",
    "MinEigCov",
    "Naruto",
    "NextBestSense",
    "NextBestSenseCov",
    "PixelOnly",
    "Planner",
    "Policy",
    "R3Recon",
    "RTGuide",
    "Random",
    "Schedule",
    "Terms",
    "UnknownVolume",
    "Unseen",
    "ViewAngle",
    "canonical_policy",
    "make_env_and_policy",
    "make_policy",
    "travel_discount",
]
