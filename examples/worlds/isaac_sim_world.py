"""Explore a USD scene in Isaac Sim 6: a free RGB-D camera without a body.

    world="world:isaac_sim_world:IsaacWorld?usd=FILE.usd&bounds=-5,-5,0,5,5,3&start=0,0,1.2,0"
    PYTHONPATH=examples/worlds ./python.sh examples/00_play.py --scene "$world"

The USD stage must have z up and metres as its unit. Its cameras look along their own -z with y up.
"""

from __future__ import annotations

import numpy as np
from isaacsim import SimulationApp
from scipy.spatial.transform import Rotation

from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.worlds import CaptureFailed, Start, checked_bounds, frame_from

FLIP = np.diag([1.0, -1.0, -1.0])  # from OpenCV's camera axes to USD's, or back
SETTLE, PATIENCE = 8, 100  # updates after a move until images show it, and largest number of updates to wait for images


class IsaacWorld:
    """Render a USD stage with the RTX renderer of Isaac Sim."""

    def __init__(
        self,
        usd: str,
        bounds: tuple[float, float, float, float, float, float],
        start: tuple[float, float, float, float],
        *,
        width: int = 160,
        height: int = 90,
        hfov: float = 90.0,
        free_radius: float = 0.5,
    ) -> None:
        self._app = SimulationApp({"headless": True})  # must exist before other modules of Isaac Sim are imported
        from isaacsim.core.experimental.utils import app, stage
        from isaacsim.sensors.experimental.rtx import CameraSensor, RtxCamera

        stage.open_stage(usd_path=usd)
        while stage.is_stage_loading():
            self._app.update()
        self._prim = RtxCamera("/World/ActiveStructureCamera")
        focal = 0.5 / np.tan(np.radians(hfov) / 2.0)  # for a horizontal aperture of 1
        self._prim.camera.set_focal_lengths(focal)
        self._prim.camera.set_apertures((1.0, height / width))
        self._prim.camera.set_clipping_ranges(0.05, 1000.0)
        self._sensor = CameraSensor(
            self._prim, resolution=(height, width), annotators=["rgb", "distance_to_image_plane"]
        )
        app.play(commit=True)
        self.camera = PinholeCamera.from_size(width, height, hfov)
        self.bounds = checked_bounds(np.reshape(bounds, (2, 3)))
        yaw = np.radians(start[3])
        self.start = Start(look_along(np.array(start[:3]), np.array([np.cos(yaw), np.sin(yaw), 0.0])), free_radius)

    def capture(self, world_from_camera: np.ndarray) -> Frame:
        x, y, z, w = Rotation.from_matrix(world_from_camera[:3, :3] @ FLIP).as_quat()
        self._prim.set_world_poses(world_from_camera[None, :3, 3], np.array([[w, x, y, z]]))
        for update in range(PATIENCE):
            self._app.update()
            images = [self._sensor.get_data(name)[0] for name in ("rgb", "distance_to_image_plane")]
            if update >= SETTLE and all(image is not None for image in images):
                rgb, depth = (image.numpy() for image in images)  # the depth of the sky is infinite
                return frame_from(rgb, depth, world_from_camera, self.camera)
        raise CaptureFailed(f"Isaac Sim gave no picture in {PATIENCE} updates")

    def close(self) -> None:
        self._app.close()
