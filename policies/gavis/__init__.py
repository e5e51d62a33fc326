"""Provide GAVIS ([gavis]): score views by the entropy of their colours, given the sides seen so far."""

from activestructure_gym.policies.gavis.policy import Gavis as Gavis
