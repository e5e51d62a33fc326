"""One room of boxes, as MJCF and as triangles: walls, a table off the axes and a ramp."""

from __future__ import annotations

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from activestructure_gym.scenes.scene import Scene, SceneMesh

# Centre, half size (metres), turns about x, y, z (degrees), colour. The room is 5 x 4 x 2.6 m inside.
BOXES = (
    ((2.5, 2.0, -0.05), (2.6, 2.1, 0.05), (0, 0, 0), (0.2, 0.3, 0.8)),  # floor: blue
    ((2.5, 2.0, 2.65), (2.6, 2.1, 0.05), (0, 0, 0), (0.9, 0.9, 0.9)),
    ((-0.05, 2.0, 1.3), (0.05, 2.1, 1.3), (0, 0, 0), (0.8, 0.2, 0.2)),  # wall towards -x: red
    ((5.05, 2.0, 1.3), (0.05, 2.1, 1.3), (0, 0, 0), (0.2, 0.7, 0.2)),  # wall towards +x: green
    ((2.5, -0.05, 1.3), (2.6, 0.05, 1.3), (0, 0, 0), (0.8, 0.8, 0.3)),
    ((2.5, 4.05, 1.3), (2.6, 0.05, 1.3), (0, 0, 0), (0.6, 0.5, 0.4)),
    ((3.3, 2.6, 0.72), (0.6, 0.35, 0.03), (0, 0, 27), (0.5, 0.3, 0.1)),  # table
    ((3.3, 2.6, 0.35), (0.06, 0.06, 0.35), (0, 0, 27), (0.3, 0.2, 0.1)),
    ((1.2, 0.8, 0.2), (0.9, 0.5, 0.04), (0, -20, 10), (0.7, 0.4, 0.7)),  # ramp
)


def mjcf() -> str:
    geoms = "\n".join(
        f'<geom type="box" pos="{_text(centre)}" size="{_text(half)}" euler="{_text(turns)}" rgba="{_text(colour)} 1"/>'
        for centre, half, turns, colour in BOXES
    )
    return (
        '<mujoco><compiler angle="degree" eulerseq="XYZ"/><visual><headlight ambient="0.6 0.6 0.6" '
        f'diffuse="0.3 0.3 0.3" specular="0 0 0"/></visual><worldbody>{geoms}</worldbody></mujoco>'
    )


def room() -> Scene:
    parts = []
    for centre, half, turns, _ in BOXES:
        place = np.eye(4)
        place[:3, :3], place[:3, 3] = Rotation.from_euler("xyz", turns, degrees=True).as_matrix(), centre
        parts.append(trimesh.creation.box(extents=2 * np.array(half), transform=place))
    joined = trimesh.util.concatenate(parts)
    colours = np.repeat([colour for *_, colour in BOXES], 8, axis=0)
    mesh = SceneMesh(
        vertices=np.asarray(joined.vertices, np.float32),
        faces=np.asarray(joined.faces, np.int32),
        colors=np.asarray(colours, np.float32),
        uv=np.zeros((len(joined.vertices), 2), np.float32),
        face_texture=np.full(len(joined.faces), -1, np.int32),
    )
    return Scene("room of boxes", mesh, "tests")


def _text(numbers: tuple[float, ...]) -> str:
    return " ".join(f"{number:g}" for number in numbers)
