"""Provide GS-Planner: score unobserved volume and badly rendered surface, with a view library."""

from activestructure_gym.policies.gs_planner.policy import GSPlanner as GSPlanner
