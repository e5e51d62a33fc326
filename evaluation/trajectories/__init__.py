"""Read camera trajectories of other programs, convert their axes, and check that they fit a scene."""
