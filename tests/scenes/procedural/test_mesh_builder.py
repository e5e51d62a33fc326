"""Placements, parts and materials end up where they should."""

from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.scenes.procedural.mesh_builder import Material, MeshBuilder
from activestructure_gym.scenes.procedural.mesh_shapes import box


def cube() -> object:
    return box(np.zeros(3), np.ones(3), max_edge=2.0)


def test_placements_nest() -> None:
    builder = MeshBuilder()
    builder.part("cube")
    # A quarter turn takes x to y: the point (1, 0) inside a frame at (2, 0) turned by 90 deg lies at (2, 1).
    with builder.placed((2.0, 0.0, 0.5), np.pi / 2), builder.placed((1.0, 0.0, 0.25)):
        builder.add(cube(), Material())
    mesh = builder.build()
    assert np.array_equal(mesh.vertices.min(axis=0), np.float32([1.0, 1.0, 0.75]))
    assert np.array_equal(mesh.vertices.max(axis=0), np.float32([2.0, 2.0, 1.75]))
    # A wall-parallel side stays exactly parallel: no cosine of 90 deg left over.
    assert set(np.unique(mesh.normals)) == {-1.0, 0.0, 1.0}


def test_parts_materials_and_indices() -> None:
    builder = MeshBuilder()
    builder.part("wall", structural=True)
    builder.add(cube(), Material(texture=3, repeats=2.0))
    builder.part("empty")
    builder.part("lamp")
    builder.add(cube(), Material(tint=(0.5, 0.6, 0.7), glow=1.2, turned=True))
    mesh = builder.build()
    assert mesh.part_names == ("wall", "empty", "lamp")
    assert mesh.part_structural.tolist() == [True, False, False]
    assert sorted(set(mesh.face_part.tolist())) == [0, 2]
    assert mesh.face_texture[mesh.face_part == 0].tolist() == [3] * 12
    assert mesh.faces[mesh.face_part == 2].min() == 24  # after the 24 vertices of the first cube
    assert np.allclose(mesh.tint[mesh.faces[-1]], (0.5, 0.6, 0.7)) and np.allclose(mesh.glow[24:], 1.2)
    assert np.allclose(mesh.uv[:24], 2 * mesh.uv[24:, ::-1])


def test_a_shape_needs_a_part() -> None:
    with pytest.raises(ValueError, match="start a part"):
        MeshBuilder().add(cube(), Material())
