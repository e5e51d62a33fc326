"""Compute a scene's ground truth, which planners must not read: free space, start poses, observable surface.

`GroundTruth` holds all of it. The agent observes a scene only through its camera.
"""

from activestructure_gym.ground_truth.free_space import FreeSpace
from activestructure_gym.ground_truth.layouts import Layout
from activestructure_gym.ground_truth.observable import ObservableSurface, observable_surface_of
from activestructure_gym.ground_truth.start_check import check_start_pose
from activestructure_gym.ground_truth.truth import GroundTruth, free_space_of, ground_truth_of, warn_if_hardly_seen

__all__ = [
    "FreeSpace",
    "GroundTruth",
    "Layout",
    "ObservableSurface",
    "check_start_pose",
    "free_space_of",
    "ground_truth_of",
    "observable_surface_of",
    "warn_if_hardly_seen",
]
