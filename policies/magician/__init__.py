"""MAGICIAN as a policy ([magician])."""

from activestructure_gym.policies.magician.policy import Magician as Magician
