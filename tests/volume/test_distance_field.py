import numpy as np
import pytest
from scipy import ndimage

from activestructure_gym.volume import distance_field


def brute_force_distance(obstacle):
    """Distance from every voxel's centre to the nearest obstacle cube, by trying all."""
    cubes = np.argwhere(obstacle)
    centers = np.argwhere(np.ones_like(obstacle))
    gaps = np.maximum(np.abs(centers[:, None] - cubes[None]) - 0.5, 0.0)
    return np.sqrt((gaps**2).sum(axis=2).min(axis=1)).reshape(obstacle.shape)


def distance_to_cubes(obstacle, at_most=np.inf):
    """Distance from every voxel's centre to the nearest obstacle cube, in voxels."""
    quarters = distance_field.squared_distances(obstacle, at_most)
    roots = [distance_field.root_of(one, np.float32(at_most**2)) for one in quarters.ravel()]
    return np.array(roots, np.float32).reshape(obstacle.shape)


@pytest.mark.parametrize("share", [0.005, 0.1, 0.6])
def test_distance_equals_brute_force(share):
    obstacle = np.random.default_rng(0).random((9, 14, 7)) < share
    obstacle[2, 3, 4] = True
    np.testing.assert_allclose(distance_to_cubes(obstacle), brute_force_distance(obstacle), atol=1e-5)


def test_distance_lies_between_half_a_voxel_and_half_a_diagonal_below_scipys():
    obstacle = np.random.default_rng(1).random((30, 25, 20)) < 0.01
    to_centers = ndimage.distance_transform_edt(~obstacle)
    shorter = (to_centers - distance_to_cubes(obstacle))[~obstacle]
    assert shorter.min() >= 0.5 - 1e-5 and shorter.max() <= np.sqrt(0.75) + 1e-5


def test_without_obstacles_the_distance_is_infinite():
    assert np.isinf(distance_to_cubes(np.zeros((3, 4, 5), bool))).all()


@pytest.mark.parametrize("most", [0.3, 2.0, 3.7])
def test_cutting_large_distances_changes_no_small_one(most):
    obstacle = np.random.default_rng(3).random((12, 10, 17)) < 0.004
    whole = distance_to_cubes(obstacle)
    assert (whole > most).any()
    cut = distance_to_cubes(obstacle, at_most=most)
    np.testing.assert_array_equal(cut, np.minimum(whole, np.float32(most)))


def test_a_box_that_reaches_out_of_the_array_is_zero_there():
    array = np.random.default_rng(0).integers(1, 9, (4, 5, 6))
    for lower, upper in (((-2, 1, 0), (3, 5, 9)), ((1, 2, 3), (2, 4, 6)), ((-1, -1, -1), (5, 6, 7))):
        expected = np.pad(array, 3)[tuple(slice(a + 3, b + 3) for a, b in zip(lower, upper))]
        np.testing.assert_array_equal(distance_field.cut_out(array, np.array(lower), np.array(upper)), expected)
    mask = np.zeros((4, 5, 6), dtype=bool)
    mask[1, 2:4, 5] = mask[3, 0, 0] = True
    assert [side.tolist() for side in distance_field.bounding_box(mask)] == [[1, 0, 0], [4, 4, 6]]
    assert not distance_field.bounding_box(np.zeros((2, 3, 4), bool))[1].any()


def test_sampling_equals_scipy_and_is_zero_far_outside():
    rng = np.random.default_rng(2)
    field = rng.random((6, 7, 8)).astype(np.float32)
    points = rng.uniform(-3, 10, size=(500, 3))
    oracle = ndimage.map_coordinates(np.pad(field, 5), points.T + 5, order=1, mode="constant")
    np.testing.assert_allclose(distance_field.sample_points(field, points), oracle, atol=1e-5)


def test_infinite_values_do_not_become_nan_on_the_grid():
    field = np.full((3, 3, 3), np.inf, np.float32)
    field[0] = 1.0
    assert distance_field.sample_points(field, np.array([[0.0, 1.0, 1.0], [1.0, 1.0, 1.0]])).tolist() == [1.0, np.inf]


def test_segment_is_checked_at_both_ends_and_between():
    field = np.ones((20, 3, 3), np.float32)
    field[10] = 0.0
    start, end = np.array([[2.0, 1.0, 1.0]]), np.array([[18.0, 1.0, 1.0]])
    assert not distance_field.segments_above(field, start, end, 0.5, 0.5)[0]
    assert distance_field.segments_above(field, start, np.array([[9.0, 1.0, 1.0]]), 0.5, 0.5)[0]
    assert not distance_field.segments_above(field, start, np.array([[9.6, 1.0, 1.0]]), 0.5, 0.5)[0]
    assert not distance_field.segments_above(field, np.array([[9.6, 1.0, 1.0]]), start, 0.5, 0.5)[0]


def test_sight_line_visits_every_voxel_that_dense_sampling_finds():
    rng = np.random.default_rng(3)
    blocking = rng.random((12, 12, 12)) < 0.08
    starts, ends = rng.uniform(0.5, 11.5, size=(2, 400, 3))
    # A line that starts in a blocking voxel is not blocked by it: keep those out, on both sides.
    keep = ~blocking[tuple(np.floor(starts).astype(int).T)]
    starts, ends = starts[keep], ends[keep]
    shares = np.linspace(0, 1, 2000)[:, None, None]
    cells = np.floor(starts + shares * (ends - starts)).astype(int)
    sampled = ~blocking[cells[..., 0], cells[..., 1], cells[..., 2]].any(axis=0)
    clear = distance_field.sight_lines(blocking, starts, ends, 0.0)
    # Sampling can step over a voxel's corner, never the other way round.
    assert not (clear & ~sampled).any()
    assert (clear == sampled).mean() > 0.98 and 0.1 < clear.mean() < 0.9
