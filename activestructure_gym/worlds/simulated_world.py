"""Simulate a robot in one of our scenes: a world without ground truth, to practise with before a real one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.ground_truth import ground_truth_of
from activestructure_gym.scenes import load_scene
from activestructure_gym.sensors import RGBDSensor, SensorConfig
from activestructure_gym.sensors.noise import DepthNoise
from activestructure_gym.specs import Spec
from activestructure_gym.worlds.base import Start
from activestructure_gym.worlds.registry import WORLDS


@WORLDS.register("simulated")
class SimulatedRobot:
    """Explore a scene with a simulated robot and its RGB-D camera, without ground truth.

    Parameters
    ----------
    scene
        Scene to load, without options; ``seed`` determines the layout of a procedural one.
    width, height, horizontal_fov_deg
        Size of the images in pixels, horizontal field of view in degrees.
    depth_noise
        Noise model of the depth camera.
    pose_noise_m, pose_noise_deg
        Standard deviation of the reported position (metres per axis) and rotation (degrees per axis). The robot itself
        goes exactly where it is sent.
    backend
        Renderer: auto, raycast or pyrender.
    seed
        Seed of the layout. It is also the seed of noise and start pose until the first reset.
    """

    def __init__(
        self,
        scene: str = "room",
        *,
        width: int = 160,
        height: int = 90,
        horizontal_fov_deg: float = 90.0,
        depth_noise: DepthNoise = "none",
        pose_noise_m: float = 0.0,
        pose_noise_deg: float = 0.0,
        backend: str = "auto",
        seed: int = 0,
    ) -> None:
        procedural = scene in ("room", "apartment", "box")
        known = ground_truth_of(load_scene(Spec.joined(scene, f"seed={seed}" if procedural else "")))
        sensor = SensorConfig(
            width=width,
            height=height,
            horizontal_fov_deg=horizontal_fov_deg,
            supersample=1,
            depth_noise=depth_noise,
            pose_noise_m=pose_noise_m,
            pose_noise_deg=pose_noise_deg,
            backend=backend,
        )
        self._space, self._scene, self._config = known.free_space, known.scene, sensor
        self.bounds = known.scene.bounds
        self.reset(seed)

    def reset(self, seed: int) -> None:
        """Put the robot at one of the scene's start poses, drawn from the seed."""
        noise, choice = (np.random.default_rng(one) for one in np.random.SeedSequence(seed).spawn(2))
        self._sensor = RGBDSensor(self._scene, self._config, noise)
        poses = self._space.start_poses
        self._pose = poses[choice.integers(len(poses))]

    @property
    def camera(self) -> PinholeCamera:
        """Return the camera's intrinsics."""
        return self._sensor.camera

    @property
    def start(self) -> Start:
        """Return the robot's current pose, and its distance to the nearest surface."""
        return Start(self._pose, float(self._space.clearance_at(self._pose[:3, 3])[0]))

    def capture(self, world_from_camera: np.ndarray) -> Frame:
        """Go to a pose [4, 4] and return the frame taken there."""
        self._pose = self.reached(np.array(world_from_camera, dtype=np.float64))
        frame = self._sensor.capture(self._pose)
        return replace(frame, depth=np.where(frame.depth > 0, frame.depth, np.float32(np.inf)))  # 0: nothing in range

    def reached(self, wanted: np.ndarray) -> np.ndarray:
        """Return the pose [4, 4] that the robot reaches when it is sent to ``wanted``; subclasses may miss it."""
        return wanted

    def close(self) -> None:
        """Release the camera."""
        self._sensor.close()
