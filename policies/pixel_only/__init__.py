"""Provide variant A of the paper's ablation (Table 3): score views by uncovered pixels."""

from activestructure_gym.policies.pixel_only.policy import PixelOnly as PixelOnly
