"""Variant A of the paper's ablation (Table 3): pixels only."""

from activestructure_gym.policies.pixel_only.policy import PixelOnly as PixelOnly
