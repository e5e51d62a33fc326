"""R3-RECON as a policy ([r3_recon])."""

from activestructure_gym.policies.r3_recon.policy import R3Recon as R3Recon
