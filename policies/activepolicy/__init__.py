"""Provide a policy inspired by ActivePolicy: choose the most central view of a graph of views."""

from activestructure_gym.policies.activepolicy.policy import ActivePolicy as ActivePolicy
