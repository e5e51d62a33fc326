"""Provide a policy that explores unknown space and unseen sides of known surfaces."""

from activestructure_gym.policies.unseen.policy import Unseen as Unseen
