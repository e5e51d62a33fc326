"""Build the closed surface around a set of lattice cells: walls, floors, ceilings, jambs and panes.

Every side of an air cell next to a cell without air becomes two triangles. The boundary of a set of cells is closed by
construction. All edges lie on the same lattice, so there are no T-junctions for rays to pass.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from activestructure_gym.scenes.procedural.mesh_builder import Material, MeshBuilder
from activestructure_gym.scenes.procedural.mesh_shapes import Shape

# Returns part name, material, and whether the texture covers the side once, for (owner, axis, sign) of a side. The sign
# is that of the direction along the axis from the air to the wall.
Describe = Callable[[int, int, int], tuple[str, Material, bool]]


def add_shell(builder: MeshBuilder, owner: np.ndarray, lines: Sequence[np.ndarray], describe: Describe) -> None:
    """Add the closed surface around all spaces to the mesh, with one structural part per flat side of every space.

    ``owner`` [X, Y, Z] is the index of the space that contains each cell (-1 = no air). ``lines`` are the coordinates
    of the lattice in metres, one more than cells per axis. Normals point into the air.
    """
    padded = np.pad(owner, 1, constant_values=-1)
    for axis in range(3):
        for sign in (-1, 1):
            inside = np.moveaxis(padded, axis, 0)
            beyond = np.roll(inside, -sign, axis=0)
            cells = np.argwhere((inside >= 0) & (beyond < 0)) - 1  # [S, 3]: (axis, the two others in order)
            of = inside[tuple((cells + 1).T)]
            for space in np.unique(of):
                name, material, fit = describe(int(space), axis, sign)
                builder.part(name, structural=True)
                layers = cells[of == space]
                for layer in np.unique(layers[:, 0]):
                    side = layers[layers[:, 0] == layer, 1:]
                    builder.add(_side(side, axis, sign, int(layer) + (sign > 0), lines, fit=fit), material)


def _side(
    cells: np.ndarray,  # [S, 2] lattice cells of a flat side, along the two other axes in order
    axis: int,
    sign: int,
    level: int,  # lattice line of the side
    lines: Sequence[np.ndarray],
    *,
    fit: bool,
) -> Shape:
    first, second = (k for k in range(3) if k != axis)
    width = len(lines[second])
    # Corners of every cell, in order, as ids of lattice points.
    corner = np.stack(
        [(cells[:, 0] + i) * width + cells[:, 1] + j for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))], axis=1
    )
    points, corner = np.unique(corner, return_inverse=True)
    corner = corner.reshape(-1, 4)
    # The cross product of the directions `first` and `second` points along +axis for the axes 0 and 2, along -axis for
    # axis 1. The normal must point into the air, which is against `sign`.
    if (sign > 0) == (axis != 1):
        corner = corner[:, ::-1]
    vertices = np.empty((len(points), 3))
    vertices[:, axis] = lines[axis][level]
    vertices[:, first] = lines[first][points // width]
    vertices[:, second] = lines[second][points % width]
    normals = np.zeros_like(vertices)
    normals[:, axis] = -sign
    uv = vertices[:, [first, second]].copy()
    if axis != 2:
        uv[:, 1] = -uv[:, 1]  # image rows run down
    if fit:
        uv = (uv - uv.min(axis=0)) / np.maximum(np.ptp(uv, axis=0), 1e-9)
    faces = np.concatenate([corner[:, [0, 1, 2]], corner[:, [0, 2, 3]]])
    return Shape(vertices, normals, faces, uv)
