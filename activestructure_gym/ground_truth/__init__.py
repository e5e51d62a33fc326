"""Ground truth of a scene, which no planner may read: free space, start poses, the observable surface.

`GroundTruth` holds all of it. Sensor noise apart, what the agent gets to know of a scene it gets from its camera.
"""

from activestructure_gym.ground_truth.free_space import FreeSpace
from activestructure_gym.ground_truth.observable import ObservableSurface, observable_surface_of
from activestructure_gym.ground_truth.start_check import POSE_ROUNDING, check_start_pose
from activestructure_gym.ground_truth.truth import GroundTruth, free_space_of, ground_truth_of, warn_if_hardly_seen

__all__ = [
    "POSE_ROUNDING",
    "FreeSpace",
    "GroundTruth",
    "ObservableSurface",
    "check_start_pose",
    "free_space_of",
    "ground_truth_of",
    "observable_surface_of",
    "warn_if_hardly_seen",
]
