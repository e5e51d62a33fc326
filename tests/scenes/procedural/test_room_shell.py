"""The shell around any set of cells is closed and encloses exactly their volume."""

from __future__ import annotations

import numpy as np

from activestructure_gym.scenes.procedural.mesh_builder import BuiltMesh, Material, MeshBuilder
from activestructure_gym.scenes.procedural.room_shell import add_shell


def shell(owner: np.ndarray, lines: list[np.ndarray], *, fit: bool = False) -> BuiltMesh:
    builder = MeshBuilder()
    add_shell(builder, owner, lines, lambda space, axis, sign: (f"{space} {axis} {sign}", Material(), fit))
    return builder.build()


def test_the_shell_of_random_cells_is_closed() -> None:
    rng = np.random.default_rng(0)
    owner = np.where(rng.random((6, 5, 4)) < 0.5, rng.integers(0, 3, (6, 5, 4)), -1)
    lines = [np.cumsum(rng.uniform(0.1, 1.0, n + 1)) for n in owner.shape]
    mesh = shell(owner, lines)
    _, merged = np.unique(mesh.vertices, axis=0, return_inverse=True)
    faces = merged.reshape(-1)[mesh.faces]
    edges = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    # As many directed edges one way as the other: a closed oriented surface without T-junctions.
    count = merged.max() + 1
    forward = np.bincount(edges[:, 0] * count + edges[:, 1], minlength=count**2)
    assert np.array_equal(forward.reshape(count, count), forward.reshape(count, count).T)
    # Normals point into the air, so the divergence theorem gives minus the volume of the cells.
    size = [np.diff(line) for line in lines]
    cells = size[0][:, None, None] * size[1][None, :, None] * size[2][None, None, :]
    a, b, c = (mesh.vertices[mesh.faces[:, k]].astype(float) for k in range(3))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6
    assert np.isclose(-volume, cells[owner >= 0].sum(), rtol=1e-5)
    assert np.einsum("ij,ij->i", np.cross(b - a, c - a), mesh.normals[mesh.faces[:, 0]]).min() > 0


def test_one_part_per_side_of_every_space_and_pictures_upright() -> None:
    owner = np.zeros((2, 3, 2), dtype=int)
    mesh = shell(owner, [np.arange(3.0), np.arange(4.0), np.arange(3.0)], fit=True)
    assert mesh.part_names == ("0 0 -1", "0 0 1", "0 1 -1", "0 1 1", "0 2 -1", "0 2 1")
    assert len(mesh.faces) == 2 * 2 * (3 * 2 + 2 * 2 + 2 * 3)
    wall = np.unique(mesh.faces[mesh.face_part == 3])
    assert np.allclose(mesh.uv[wall, 1], 1 - mesh.vertices[wall, 2] / 2)  # v = 0 at the top
