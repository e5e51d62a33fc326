"""Deciders that know the ground truth or a whole path: oracles, and trajectories that are followed."""
