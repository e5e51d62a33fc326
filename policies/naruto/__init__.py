"""Provide NARUTO: move to where most uncertainty is visible, then view the most uncertain targets."""

from activestructure_gym.policies.naruto.policy import Naruto as Naruto
