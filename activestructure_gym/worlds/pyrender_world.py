"""Explore a mesh file that pyrender draws with OpenGL."""

from __future__ import annotations

from activestructure_gym.worlds.registry import WORLDS
from activestructure_gym.worlds.simulated_world import SimulatedRobot


@WORLDS.register("pyrender")
def pyrender_world(
    file: str, *, width: int = 160, height: int = 90, horizontal_fov_deg: float = 90.0, seed: int = 0
) -> SimulatedRobot:
    """Explore a mesh file that pyrender draws with OpenGL, without ground truth.

    An episode begins at a free place of the mesh. Colours are those of its textures and vertices, as with
    ``sensor.backend=pyrender`` in a scene: neither trimesh nor pyrender reads the lights of a file.
    """
    return SimulatedRobot(
        file, width=width, height=height, horizontal_fov_deg=horizontal_fov_deg, backend="pyrender", seed=seed
    )
