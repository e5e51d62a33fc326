"""Provide a baseline that scores views by the unseen area behind holes of the map."""

from activestructure_gym.policies.hole_area.policy import HoleArea as HoleArea
