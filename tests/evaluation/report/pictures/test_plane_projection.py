import numpy as np

from activestructure_gym.evaluation.report.pictures.plane_projection import (
    NO_PLANE,
    Projection,
    covered_pixels,
    nearest_planes,
    outer_cells,
    outlines,
)

ABOVE = Projection(np.array([[20.0, 0, 0], [0, -20.0, 0]]), np.array([0.0, 60.0]), np.array([0, 0, 1.0]), (80, 60))
# From the south, halfway up: what is higher or further south is nearer.
SLANTED = Projection(
    np.array([[20.0, 0, 0], [0, -20 * np.sqrt(0.5), -20 * np.sqrt(0.5)]]),
    np.array([0.0, 60.0]),
    np.array([0, -np.sqrt(0.5), np.sqrt(0.5)]),
    (80, 60),
)


def test_a_floor_from_above_covers_its_own_pixels_only(wall_and_floor):
    window, shown, near = covered_pixels(wall_and_floor, 0, ABOVE)
    page = np.zeros((60, 80), bool)
    page[window] = shown
    hole = page[60 - 12 : 60 - 6, 60:66]  # x 3.0 .. 3.3 and y 0.3 .. 0.6 m
    assert not hole[1:-1, 1:-1].any() and page.sum() > 0.98 * (80 * 60 - 36)
    np.testing.assert_allclose(near[shown], 0.0, atol=1e-9)
    assert covered_pixels(wall_and_floor, 1, ABOVE) is None  # edge-on


def test_every_pixel_shows_the_nearest_plane(wall_and_floor):
    owner, nearness = nearest_planes(wall_and_floor, SLANTED)
    for point, expected in (([2.0, 1.5, 0.5], 1), ([0.5, 0.5, 0.0], 0), ([2.0, 2.0, 0.0], 1)):
        x, y = SLANTED.pixels(np.array(point)).astype(int)
        assert owner[y, x] == expected, point
    x, y = SLANTED.pixels(np.array([2.0, 1.5, 0.5])).astype(int)
    assert abs(nearness[y, x] - SLANTED.nearness(np.array([2.0, 1.5, 0.5]))) < 0.1


def test_planes_that_face_away_hide_nothing(wall_and_floor):
    wall_and_floor["normals"] = wall_and_floor["normals"] * [[1.0], [-1.0]]
    owner, _ = nearest_planes(wall_and_floor, SLANTED)
    assert set(np.unique(owner)) == {NO_PLANE, 0}


def test_outlines_go_around_the_surface_and_its_holes(wall_and_floor):
    lengths = sorted(np.ptp(line, axis=0).max() for line in outlines(wall_and_floor, 0, ABOVE))
    assert len(lengths) == 2 and 3 <= lengths[0] <= 8 and lengths[1] >= 76


def test_nothing_lies_further_out_than_the_extremes(wall_and_floor, no_planes):
    points = outer_cells(wall_and_floor)
    np.testing.assert_allclose([points.min(axis=0), points.max(axis=0)], [[0.05, 0.05, 0], [3.95, 2.95, 0.95]])
    assert outer_cells(no_planes).shape == (0, 3)
