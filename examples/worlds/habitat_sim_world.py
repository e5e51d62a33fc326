"""Explore a scene in Habitat-Sim: a free RGB-D camera without a body.

    PYTHONPATH=examples/worlds asg explore --world "habitat_sim_world:HabitatWorld?scene=FILE.glb"

The world frame of Habitat has y up, and its cameras look along -z with y up.
"""

from __future__ import annotations

import habitat_sim
import numpy as np
from scipy.spatial.transform import Rotation

from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.worlds import Start, frame_from

OURS_FROM_HABITAT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # world with y up to world with z up
FLIP = np.diag([1.0, -1.0, -1.0])  # from OpenCV's camera axes to OpenGL's, or back


class HabitatWorld:
    """Render a scene in Habitat-Sim; an episode begins at a random point of its navigation mesh."""

    def __init__(
        self, scene: str, *, width: int = 160, height: int = 90, hfov: float = 90.0, camera_height: float = 1.2
    ) -> None:
        backend, agent = habitat_sim.SimulatorConfiguration(), habitat_sim.agent.AgentConfiguration()
        backend.scene_id, self._height = scene, camera_height
        kinds = {"color": habitat_sim.SensorType.COLOR, "depth": habitat_sim.SensorType.DEPTH}
        for name, kind in kinds.items():
            sensor = habitat_sim.CameraSensorSpec()
            sensor.uuid, sensor.sensor_type, sensor.resolution, sensor.hfov = name, kind, [height, width], hfov
            sensor.position = [0.0, 0.0, 0.0]  # the default is 1.5 m above the agent
            agent.sensor_specifications = [*agent.sensor_specifications, sensor]
        self._sim = habitat_sim.Simulator(habitat_sim.Configuration(backend, [agent]))
        self.camera = PinholeCamera.from_size(width, height, hfov)
        box = self._sim.get_active_scene_graph().get_root_node().cumulative_bb
        corners = np.array([box.min, box.max]) @ OURS_FROM_HABITAT.T
        self.bounds = np.sort(corners, axis=0)
        self.reset(0)

    def reset(self, seed: int) -> None:
        paths = self._sim.pathfinder
        paths.seed(seed)
        place = paths.get_random_navigable_point()
        free = min(paths.distance_to_closest_obstacle(place, 2.0), 0.9 * self._height)
        position = OURS_FROM_HABITAT @ place + (0.0, 0.0, self._height)
        self.start = Start(look_along(position, np.array([1.0, 0.0, 0.0])), free)

    def capture(self, world_from_camera: np.ndarray) -> Frame:
        rotation = Rotation.from_matrix(OURS_FROM_HABITAT.T @ world_from_camera[:3, :3] @ FLIP)
        position = OURS_FROM_HABITAT.T @ world_from_camera[:3, 3]
        self._sim.get_agent(0).set_state(habitat_sim.AgentState(position, rotation.as_quat()))  # x, y, z, w
        seen = self._sim.get_sensor_observations()
        return frame_from(seen["color"], seen["depth"], world_from_camera, self.camera)

    def close(self) -> None:
        self._sim.close()
