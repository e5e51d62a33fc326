from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.scenes.loaders.damage import UnreadableMesh
from activestructure_gym.scenes.loaders.polygons import concave_corners, ear_clipped, triangulated

# A wall of 5 x 3 m with a doorway of 1 x 2 m, (x, z).
DOORWAY = [(0, 0), (1, 0), (1, 2), (2, 2), (2, 0), (5, 0), (5, 3), (0, 3)]
SQUARE = [(0, 0), (1, 0), (1, 1), (0, 1)]
ARROW = [(0, 0), (2, 1), (0, 2), (1, 1)]  # turns back at its last corner
STEP = [(0, 0), (1, 0), (2, 0), (2, 1), (0, 1)]  # a corner in the middle of a side


def upright(outline):
    """Points (x, z) as a polygon in space, leaning so that no axis is its own."""
    x, z = np.array(outline, dtype=float).T
    return np.stack([x * 0.8, x * 0.6, z], axis=1)


def areas(points, triangles):
    a, b, c = (points[triangles[:, k]] for k in range(3))
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


@pytest.mark.parametrize("outline, area", [(DOORWAY, 13.0), (SQUARE, 1.0), (ARROW, 1.0), (STEP, 2.0)])
@pytest.mark.parametrize("shift", range(8))
@pytest.mark.parametrize("backwards", [False, True])
def test_area_and_winding_whatever_the_first_corner(outline, area, shift, backwards):
    points = np.roll(upright(outline), shift, axis=0)[:: -1 if backwards else 1]
    triangles, polygon = triangulated(points, np.array([len(points)]))
    assert areas(points, triangles).sum() == pytest.approx(area)
    assert (polygon == 0).all()
    a, b, c = (points[triangles[:, k]] for k in range(3))
    facing = np.cross(b - a, c - a) @ [0.6, -0.8, 0.0]
    assert (facing >= -1e-12).all() if not backwards else (facing <= 1e-12).all()


def test_convex_polygons_stay_fans_and_keep_their_order():
    points = np.concatenate([upright(o) for o in (SQUARE, DOORWAY, SQUARE[:3], STEP, SQUARE[:2])])
    sizes = np.array([4, 8, 3, 5, 2])
    assert concave_corners(points, sizes)[0].tolist() == [1, 1]  # both upper corners of the doorway
    triangles, polygon = triangulated(points, sizes)
    assert triangles[:2].tolist() == [[0, 1, 2], [0, 2, 3]]
    assert triangles[polygon >= 2].tolist() == [[12, 13, 14], [15, 16, 17], [15, 17, 18], [15, 18, 19]]
    assert polygon.tolist() == sorted(polygon) and np.bincount(polygon).tolist() == [2, 6, 1, 3]


def test_random_stars_have_the_area_of_the_shoelace_formula(rng):
    for corners in (5, 8, 20, 60):
        angle = np.sort(rng.random(corners)) * 2 * np.pi
        x, z = rng.uniform(0.2, 2.0, corners) * np.array([np.cos(angle), np.sin(angle)])
        expected = 0.5 * abs((x * np.roll(z, -1) - np.roll(x, -1) * z).sum())
        points = upright(np.stack([x, z], axis=1)) + [10.0, -3.0, 2.0]
        if np.diff(angle, append=angle[0] + 2 * np.pi).max() < np.pi:  # the centre lies inside
            triangles, _ = triangulated(points, np.array([corners]))
            assert areas(points, triangles).sum() == pytest.approx(expected)


def test_a_polygon_that_would_take_minutes_is_refused():
    points = np.random.default_rng(0).random((10_001, 3))
    with pytest.raises(UnreadableMesh, match="has 10,001 corners"):
        triangulated(points, np.array([len(points)]))


def test_a_hole_stays_open():
    points = upright(SQUARE) * 4, upright([(1, 1), (2, 1), (2, 3), (1, 3)])
    both = np.concatenate(points)
    assert areas(both, ear_clipped(both, (4, 8))).sum() == pytest.approx(16 - 2)


def test_polygons_without_an_area_and_with_broken_corners_are_left_as_fans():
    line = upright([(0, 0), (1, 0), (3, 0), (2, 0)])
    broken = upright(DOORWAY)
    broken[2] = np.nan
    sizes = np.array([4, 8])
    triangles, _ = triangulated(np.concatenate([line, broken]), sizes)
    assert len(triangles) == 8
