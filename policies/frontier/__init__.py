"""Provide ActiveGS's frontier planner: score visible unexplored space, minus path length."""

from activestructure_gym.policies.frontier.policy import Frontier as Frontier
