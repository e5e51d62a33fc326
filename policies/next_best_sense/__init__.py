"""Next Best Sense as a policy ([next_best_sense])."""

from activestructure_gym.policies.next_best_sense.policy import NextBestSense as NextBestSense
from activestructure_gym.policies.next_best_sense.policy import NextBestSenseCov as NextBestSenseCov
