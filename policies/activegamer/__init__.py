"""ActiveGAMER: two stages of uncovered pixels, then the keyframes that render worst."""

from activestructure_gym.policies.activegamer.policy import ActiveGAMER as ActiveGAMER
