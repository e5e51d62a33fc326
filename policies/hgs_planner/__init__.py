"""Provide HGS-Planner ([hgs_planner], by its text): choose local views by gain, then follow a tour of other regions."""

from activestructure_gym.policies.hgs_planner.policy import HGSPlanner as HGSPlanner
