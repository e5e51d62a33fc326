"""Frontier exploration as ActiveGS ships it beside its own planner: unknown space in sight, less the way."""

from activestructure_gym.policies.frontier.policy import Frontier as Frontier
