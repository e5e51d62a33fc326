"""Provide a policy that chooses at random, the lower reference of comparisons."""

from activestructure_gym.policies.random.policy import Random as Random
