"""Provide ANM (ActiveINR): move to the largest cluster of uncertain surface, at any distance."""

from activestructure_gym.policies.activeinr.policy import ActiveINR as ActiveINR
