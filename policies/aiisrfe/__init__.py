"""The mode-switching planner of Zeng et al. ([aiisrfe]): frontiers first, then frontiers and unsure surface in turn."""

from activestructure_gym.policies.aiisrfe.policy import Aiisrfe as Aiisrfe
