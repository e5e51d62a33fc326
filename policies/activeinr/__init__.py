"""ANM (ActiveINR): go to the largest piece of uncertain surface, however far."""

from activestructure_gym.policies.activeinr.policy import ActiveINR as ActiveINR
