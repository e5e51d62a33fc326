"""Inspired by ActivePolicy: the view in the middle of the graph of views."""

from activestructure_gym.policies.activepolicy.policy import ActivePolicy as ActivePolicy
