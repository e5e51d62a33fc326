"""The light baker against closed forms: inverse square, cosine, shadow, and the series of the bounces."""

from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.scenes.procedural import baked_light
from activestructure_gym.scenes.procedural.baked_light import WindowLight, bake_light
from activestructure_gym.scenes.procedural.furniture import Light
from activestructure_gym.scenes.procedural.mesh_builder import BuiltMesh, Material, MeshBuilder
from activestructure_gym.scenes.procedural.mesh_shapes import box
from activestructure_gym.scenes.procedural.room_shell import add_shell
from activestructure_gym.scenes.raycaster import RayCaster


def room(size: tuple[float, float, float] = (4.0, 4.0, 3.0), cells: int = 12, *, table: bool = False) -> BuiltMesh:
    builder = MeshBuilder()
    lines = [np.linspace(0, extent, cells + 1) for extent in size]
    add_shell(builder, np.zeros((cells,) * 3, int), lines, lambda *_: ("side", Material(), False))
    if table:
        builder.part("table")
        builder.add(box(np.array([1.5, 1.5, 0.7]), np.array([2.5, 2.5, 0.75])), Material())
    return builder.build()


def test_a_lamp_falls_off_with_square_and_cosine(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = room()
    monkeypatch.setattr(baked_light, "_expose", lambda irradiance, area: irradiance)
    lamp = Light((2.0, 2.0, 2.0), 1e-6, (3.0, 2.0, 1.0))
    black = np.zeros((len(mesh.faces), 3), np.float32)
    caster = RayCaster(mesh.vertices, mesh.faces)
    irradiance = bake_light(mesh, caster, face_albedo=black, lights=[lamp], windows=[])
    # Straight below: 2 m away, facing the lamp: power / 2^2.
    inner = (np.abs(mesh.vertices - [2, 2, 0]) < 1e-3).all(axis=1)
    assert np.allclose(irradiance[inner], np.array([3.0, 2.0, 1.0]) / 4, rtol=0.02)
    # 1 m to the side on the floor (a grid line: 9 cells of 1/3 m): distance sqrt(5), cosine 2 / sqrt(5).
    aside = (np.abs(mesh.vertices - [3, 2, 0]) < 1e-3).all(axis=1)
    assert aside.any()
    assert np.allclose(irradiance[aside, 0], 3.0 * 2 / np.sqrt(5) / 5, rtol=0.02)
    # A lamp whose light upward is 20 % gives the spot right above it 20 %: 1 m away, 3.0 * 0.2.
    dimmed = Light((2.0, 2.0, 2.0), 1e-6, (3.0, 2.0, 1.0), upward=0.2)
    above = (np.abs(mesh.vertices - [2, 2, 3]) < 1e-3).all(axis=1)
    irradiance = bake_light(mesh, caster, face_albedo=black, lights=[dimmed], windows=[])
    assert np.allclose(irradiance[above, 0], 0.6, rtol=0.05)


def test_a_table_casts_a_shadow() -> None:
    mesh = room(table=True)
    lamp = Light((2.0, 2.0, 2.5), 0.05, (2.0, 2.0, 2.0))
    grey = np.full((len(mesh.faces), 3), 0.5, np.float32)
    factor = bake_light(mesh, RayCaster(mesh.vertices, mesh.faces), face_albedo=grey, lights=[lamp], windows=[])
    floor = (mesh.vertices[:, 2] == 0) & (mesh.normals[:, 2] > 0)
    middle = np.abs(mesh.vertices[:, :2] - 2.0).max(axis=1)
    under, around = floor & (middle < 0.4), floor & (middle > 1.1) & (middle < 1.4)
    assert under.any() and around.any()
    # Display values: 0.75 is half the light.
    assert factor[under].mean() < 0.75 * factor[around].mean()
    assert np.isfinite(factor).all() and factor.min() > 0 and factor.max() <= 1.1


def test_vertices_inside_furniture_take_the_light_around_them() -> None:
    # A strip of triangles 0-1-2, 1-2-3, 2-3-4 ...; 3 and 4 are buried, 4 is one step farther from the light than 3.
    faces = np.array([[0, 1, 2], [1, 2, 3], [2, 3, 4]])
    values = np.array([[1.0] * 3, [2.0] * 3, [4.0] * 3, [0.0] * 3, [0.0] * 3])
    baked_light._fill(values, np.array([True, True, True, False, False]), faces)
    # Edges of 3 to known vertices: 1-3 once, 2-3 in two triangles; of 4: 2-4 once (3 was unknown in that round).
    assert np.allclose(values[:, 0], [1, 2, 4, (2 + 4 + 4) / 3, 4])


def test_a_solid_block_does_not_stain_the_floor_around_it() -> None:
    # A block on the floor, its sides on grid lines' middles: the floor's vertices inside are dark, those outside not.
    builder = MeshBuilder()
    lines = [np.linspace(0, extent, 13) for extent in (4.0, 4.0, 3.0)]
    add_shell(builder, np.zeros((12,) * 3, int), lines, lambda *_: ("side", Material(), False))
    builder.part("block")
    builder.add(box(np.array([1.5, 1.5, 0.0]), np.array([2.5, 2.5, 0.3])), Material())
    mesh = builder.build()
    lamp = Light((2.0, 2.0, 2.5), 0.3, (2.0, 2.0, 2.0))
    grey = np.full((len(mesh.faces), 3), 0.5, np.float32)
    factor = bake_light(mesh, RayCaster(mesh.vertices, mesh.faces), face_albedo=grey, lights=[lamp], windows=[])
    floor = (mesh.vertices[:, 2] == 0) & (mesh.normals[:, 2] > 0)
    inside = np.abs(mesh.vertices[:, :2] - 2.0).max(axis=1) < 0.45
    beside = np.abs(np.abs(mesh.vertices[:, :2] - 2.0).max(axis=1) - 2 / 3) < 0.05
    assert (floor & inside).any() and (floor & beside).any()
    assert factor[floor & inside].mean() > 0.8 * factor[floor & beside].mean()


def test_bounces_add_up_to_the_geometric_series() -> None:
    # In a closed room with the same direct light E everywhere and albedo a, three bounces give E (1 + a + a^2 + a^3).
    mesh = room(cells=6)
    lit = np.arange(len(mesh.vertices))
    samples = baked_light._samples(mesh, lit)
    direct = np.full((len(lit), 3), 2.0, np.float32)
    albedo = np.tile(np.float32([0.5, 0.2, 0.0]), (len(mesh.faces), 1))
    caster = RayCaster(mesh.vertices, mesh.faces)
    irradiance, buried = baked_light._bounce(mesh, caster, samples, lit, direct, albedo)
    assert not buried.any()
    expected = [2 * (1 + a + a**2 + a**3) for a in (0.5, 0.2, 0.0)]
    assert np.allclose(irradiance, expected, rtol=1e-4)


def test_gathering_directions_are_cosine_weighted() -> None:
    directions = baked_light._directions(16)
    assert np.allclose(np.linalg.norm(directions, axis=1), 1, atol=1e-6)
    # Means over a cosine-weighted hemisphere: z -> 2/3, x and y -> 0.
    assert np.allclose(directions.mean(axis=0), [0, 0, 2 / 3], atol=5e-3)


def test_a_window_lights_the_wall_across(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(baked_light, "_expose", lambda irradiance, area: irradiance)
    mesh = room()
    window = WindowLight(
        lower=np.array([0.0, 1.9, 1.4]),
        upper=np.array([0.0, 2.1, 1.6]),
        inward=np.array([1.0, 0.0, 0.0]),
        room=np.array([[0.0, 0.0, 0.0], [4.0, 4.0, 3.0]]),
        emission=(100.0, 50.0, 0.0),
    )
    black = np.zeros((len(mesh.faces), 3), np.float32)
    irradiance = bake_light(mesh, RayCaster(mesh.vertices, mesh.faces), face_albedo=black, lights=[], windows=[window])
    across = (np.abs(mesh.vertices - [4, 2, 1.5]) < 1e-3).all(axis=1)
    # M / pi * area / d^2 with M = 100, area = 0.04 m^2, d = 4 m (both cosines 1), to the pane's 2 cm offset.
    assert across.any()
    assert np.allclose(irradiance[across], np.array([100, 50, 0]) / np.pi * 0.04 / 4.0**2, rtol=0.03)


def test_glow_is_not_shaded() -> None:
    builder = MeshBuilder()
    builder.part("lamp")
    builder.add(box(np.zeros(3), np.ones(3)), Material(glow=1.1))
    builder.part("floor")
    builder.add(box(np.array([-1, -1, -1.0]), np.array([2, 2, -0.5])), Material())
    mesh = builder.build()
    grey = np.full((len(mesh.faces), 3), 0.5, np.float32)
    lamp = Light((3.0, 3.0, 3.0), 0.1, (1.0, 1.0, 1.0))
    factor = bake_light(mesh, RayCaster(mesh.vertices, mesh.faces), face_albedo=grey, lights=[lamp], windows=[])
    assert np.allclose(factor[mesh.glow > 0], 1.1)


def test_a_trim_on_a_wall_leaves_no_dark_spots() -> None:
    """The sides of the trim lie on lines of the wall's grid, so samples would be in the planes of these sides."""
    builder = MeshBuilder()
    lines = [np.linspace(0, extent, 13) for extent in (4.0, 4.0, 3.0)]
    add_shell(builder, np.zeros((12,) * 3, int), lines, lambda *_: ("side", Material(), False))
    builder.add(box(np.array([lines[0][3], 0.0, 0.0]), np.array([lines[0][4], 0.02, 3.0])), Material())
    mesh = builder.build()
    caster = RayCaster(mesh.vertices, mesh.faces)
    grey = np.full((len(mesh.faces), 3), 0.5, np.float32)
    lamp = Light((2.0, 2.0, 1.5), 0.05, (2.0, 2.0, 2.0))
    light = bake_light(mesh, caster, face_albedo=grey, lights=[lamp], windows=[])[:, 0]
    wall = (mesh.vertices[:, 1] == 0) & (mesh.normals[:, 1] > 0.5)
    for column in (3, 4):
        rows = np.flatnonzero(wall & (np.abs(mesh.vertices[:, 0] - lines[0][column]) < 1e-3))
        rows = rows[np.argsort(mesh.vertices[rows, 2])][2:-2]
        assert len(rows) >= 8 and np.abs(np.diff(light[rows])).max() < 0.05
