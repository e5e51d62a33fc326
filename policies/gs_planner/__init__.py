"""GS-Planner: unobserved volume that light would reach, badly rendered surface, and a library of views left behind."""

from activestructure_gym.policies.gs_planner.policy import GSPlanner as GSPlanner
