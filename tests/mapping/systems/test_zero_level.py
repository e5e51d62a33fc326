"""The surface cut out of a grid: spheres and planes, where nobody looked, and disks across the normal."""

import numpy as np
import pytest

from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.geometry.rotations import matrix_rows
from activestructure_gym.mapping.systems.co_slam.zero_level import Crossings, VertexGrid, disks

BOX = np.array([[-1.0, -1, -1], [1, 1, 1]])


def test_a_plane_is_met_where_it_stands():
    """x = .33 in a grid of .25 m: one crossing on each of 9 x 9 edges along x, exact for a linear field."""
    grid = VertexGrid(BOX, 0.25)
    grid.seen[:] = True
    found = grid.crossings((0.33 - grid.points()[:, 0]).reshape(grid.shape))
    assert len(found.points) == 81
    assert found.points[:, 0] == pytest.approx(0.33)
    assert found.normals == pytest.approx(np.tile([-1.0, 0, 0], (81, 1)))


def test_a_sphere_is_met_to_a_fraction_of_a_cell():
    grid = VertexGrid(BOX, 0.1)
    grid.seen[:] = True
    found = grid.crossings((np.linalg.norm(grid.points(), axis=1) - 0.7).reshape(grid.shape))
    radius = np.linalg.norm(found.points, axis=1)
    assert np.abs(radius - 0.7).max() < 0.005 and len(found.points) > 4 * np.pi * 0.49 / 0.01
    assert np.einsum("ij,ij->i", found.normals, found.points / radius[:, None]).min() > 0.99


def test_nothing_is_met_where_nobody_looked():
    grid = VertexGrid(BOX, 0.25)
    values = (0.33 - grid.points()[:, 0]).reshape(grid.shape)
    assert len(grid.crossings(values).points) == 0
    grid.seen[:, :4] = True  # y below -.25
    assert len(grid.crossings(values).points) == 4 * 9
    grid.seen[6:] = False  # on the far side of the plane
    assert len(grid.crossings(values).points) == 0


@pytest.mark.parametrize("slant", [0.0, 45.0, 60.0])
def test_normals_are_those_of_the_surface_though_little_behind_it_was_seen(slant):
    """A plane at .6 m, seen by one keyframe up to .1 m behind it, 1 where nobody looked."""
    normal = -np.array([np.sin(np.radians(slant)), 0.0, np.cos(np.radians(slant))])
    camera = PinholeCamera.from_size(80, 80, 60.0)
    depth = (-0.6 * np.cos(np.radians(slant)) / (camera.rays() @ normal)).astype(np.float32)
    grid = VertexGrid(BOX, 0.05)
    grid.observe(Frame(np.zeros((80, 80, 3), np.uint8), np.where(depth > 0, depth, 0), np.eye(4), camera), behind=0.1)
    distance = (grid.points() @ normal + 0.6 * np.cos(np.radians(slant))).reshape(grid.shape)
    found = grid.crossings(np.where(grid.seen, distance, 1.0))
    assert len(found.points) > 100
    assert np.quantile(found.normals @ normal, 0.02) > np.cos(np.radians(20.0))


def test_a_look_reaches_a_little_behind_what_it_measured():
    """From the origin along z, .5 m measured: vertices on the axis up to .6 m, none without a return or outside."""
    grid = VertexGrid(BOX, 0.1)
    camera = PinholeCamera.from_size(20, 20)
    depth = np.full((20, 20), 0.5, np.float32)
    depth[:, :10] = 0.0
    grid.observe(Frame(np.zeros((20, 20, 3), np.uint8), depth, np.eye(4), camera), behind=0.101)
    seen = grid.points()[grid.seen.ravel()]
    assert seen[:, 2].min() > 0 and seen[:, 2].max() == pytest.approx(0.6)
    assert seen[:, 0].min() > -1e-9 and (np.abs(seen[:, :2]) <= seen[:, 2:] + 1e-9).all()
    axis = seen[(np.abs(seen[:, :2]) < 1e-9).all(axis=1)]
    assert axis[:, 2] == pytest.approx(np.arange(1, 7) / 10)


def test_disks_lie_across_their_normal():
    normals = np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, -1], [0.6, 0, 0.8]])
    block = disks(Crossings(np.arange(12.0).reshape(4, 3), normals), np.ones((4, 3)), 0.02, thickness=0.1, opacity=0.99)
    assert np.exp(block[7:10]) == pytest.approx(np.repeat([[0.02], [0.02], [0.002]], 4, axis=1))
    rotation = np.array(matrix_rows(*block[3:7].astype(np.float64)))  # [world, axis, n]
    assert rotation[:, 2].T == pytest.approx(normals, abs=1e-6)
    assert 1 / (1 + np.exp(-block[10])) == pytest.approx(0.99)
