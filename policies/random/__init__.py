"""Provide uniform random choice, the lower reference of comparisons."""

from activestructure_gym.policies.random.policy import Random as Random
