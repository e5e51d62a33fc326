"""Provide exploration of unknown space and of unseen sides of known surfaces."""

from activestructure_gym.policies.unseen.policy import Unseen as Unseen
