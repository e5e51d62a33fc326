"""Provide the planner of Zeng et al. ([aiisrfe]): visit frontiers and views of uncertain surface on short tours."""

from activestructure_gym.policies.aiisrfe.policy import Aiisrfe as Aiisrfe
