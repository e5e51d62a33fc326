"""GAVIS as a policy ([gavis])."""

from activestructure_gym.policies.gavis.policy import Gavis as Gavis
