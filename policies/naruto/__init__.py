"""NARUTO: go where most uncertainty is within sight, then look at the worst of it."""

from activestructure_gym.policies.naruto.policy import Naruto as Naruto
