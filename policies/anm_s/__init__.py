"""ANM-S: from node to node of the floor plan by an integer score, with a look at each uncertain piece of surface."""

from activestructure_gym.policies.anm_s.policy import AnmS as AnmS
