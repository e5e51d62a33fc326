"""Provide R3-RECON ([r3_recon]): score unexplored space and surface that cannot be rendered well from a side."""

from activestructure_gym.policies.r3_recon.policy import R3Recon as R3Recon
