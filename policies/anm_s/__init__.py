"""Provide ANM-S: move between nodes of the floor plan by an integer score, and view the uncertain surface at each."""

from activestructure_gym.policies.anm_s.policy import AnmS as AnmS
