"""Make a world of a triangle mesh: the scene, drawn by the simulated RGB-D sensor, with its ground truth."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.ground_truth import GroundTruth, check_start_pose
from activestructure_gym.motion import unrounded_start
from activestructure_gym.sensors import RGBDSensor, SensorConfig
from activestructure_gym.worlds.base import Start

if TYPE_CHECKING:
    from activestructure_gym.scenes import Scene


class SceneWorld:
    """Explore a triangle mesh with the simulated sensor.

    The agent is always exactly where it was sent. With pose noise, the pose of a frame is a noisy report.

    Parameters
    ----------
    truth
        The scene and its free space.
    sensor
        Camera and noise.
    noise
        Random generator of all sensor noise.
    start_pose
        ``world_from_camera`` [4, 4] without roll.
    body_radius
        Metres that must be free around the start pose.

    Raises
    ------
    InputError
        If the start pose is outside the scene or in collision.
    """

    exact_motion = True  # a frame's pose may be noisy; the agent's is not

    def __init__(
        self,
        truth: GroundTruth,
        sensor: SensorConfig,
        noise: np.random.Generator,
        *,
        start_pose: np.ndarray,
        body_radius: float,
    ) -> None:
        check_start_pose(truth, start_pose, body_radius)
        pose = unrounded_start(np.array(start_pose, dtype=np.float64))
        self.truth = truth
        self.sensor = RGBDSensor(truth.scene, sensor, noise)
        self.start = Start(pose, float(truth.free_space.clearance_at(pose[:3, 3])[0]))

    @property
    def scene(self) -> Scene:
        """Return the scene."""
        return self.truth.scene

    @property
    def bounds(self) -> np.ndarray:
        """Return the scene's bounding box [2, 3] in metres."""
        return self.truth.scene.bounds

    @property
    def camera(self) -> PinholeCamera:
        """Return the sensor's intrinsics."""
        return self.sensor.camera

    def capture(self, world_from_camera: np.ndarray) -> Frame:
        """Render a frame at a pose [4, 4]."""
        return self.sensor.capture(world_from_camera)

    def close(self) -> None:
        """Release the sensor's threads and graphics contexts."""
        self.sensor.close()
