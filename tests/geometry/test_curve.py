"""Order along a space-filling curve."""

import numpy as np

from activestructure_gym.geometry.curve import curve_order


def test_corners_of_a_cube_by_hand():
    corners = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
    wanted = np.argsort(corners @ [1, 2, 4])  # x turns over first, then y, then z
    np.testing.assert_array_equal(curve_order(corners), wanted)
    assert curve_order(np.zeros((0, 3))).shape == (0,)
    np.testing.assert_array_equal(curve_order(np.ones((3, 3))), [0, 1, 2])  # points in one place stay in order


def test_blocks_of_neighbours_become_small():
    points = np.random.default_rng(0).random((4096, 3))

    def extent(order):
        return np.ptp(points[order].reshape(-1, 64, 3), axis=1).prod(axis=1).mean()

    assert extent(curve_order(points)) < 0.1 * extent(np.arange(4096))
