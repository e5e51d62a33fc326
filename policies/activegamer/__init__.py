"""Provide ActiveGAMER: cover uncovered pixels in two stages, then revisit the keyframes with the lowest PSNR."""

from activestructure_gym.policies.activegamer.policy import ActiveGAMER as ActiveGAMER
