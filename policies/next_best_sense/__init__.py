"""Provide Next Best Sense ([next_best_sense]): score views by Fisher information of colour and depth."""

from activestructure_gym.policies.next_best_sense.policy import NextBestSense as NextBestSense
from activestructure_gym.policies.next_best_sense.policy import NextBestSenseCov as NextBestSenseCov
