"""Define a scene by a function, and print its number of start poses.

python examples/04_own_scene.py
"""

import numpy as np
import trimesh

from activestructure_gym.ground_truth import ground_truth_of
from activestructure_gym.scenes import SCENES, Scene, SceneMesh


@SCENES.register("cube_room")
def cube_room(*, side: float = 4.0) -> Scene:
    """Return a room with walls of random colours; ``side`` is its length and width in metres."""
    room = trimesh.creation.box((side, side, 2.6)).subdivide().subdivide()
    room.apply_translation((0.0, 0.0, 1.3))
    colors = np.random.default_rng(0).uniform(0.2, 0.9, (len(room.vertices), 3))
    mesh = SceneMesh(
        vertices=room.vertices.astype(np.float32),
        faces=room.faces.astype(np.int32),
        colors=colors.astype(np.float32),
        uv=np.zeros((len(room.vertices), 2), np.float32),
        face_texture=np.full(len(room.faces), -1, np.int32),
    )
    return Scene(name="cube_room", mesh=mesh, source=f"cube_room(side={side})")


if __name__ == "__main__":
    truth = ground_truth_of(cube_room(side=5.0))
    print(f"{len(truth.free_space.start_poses)} start poses")
