"""All that is not seen yet, behind the known space and behind the known surfaces, as the only score."""

from activestructure_gym.policies.unseen.policy import Unseen as Unseen
