"""The unknown surface behind a view's holes as the only score."""

from activestructure_gym.policies.hole_area.policy import HoleArea as HoleArea
