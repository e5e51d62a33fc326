"""Which planes a view sees, by hand."""

from __future__ import annotations

import numpy as np

from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.views import visible_planes

CAMERA = PinholeCamera.from_size(40, 24)


def patch(center: tuple[float, float, float], normal_axis: int) -> np.ndarray:  # [9, 3]
    grid = np.stack(np.meshgrid([-0.1, 0, 0.1], [-0.1, 0, 0.1]), axis=-1).reshape(-1, 2)
    return np.asarray(center) + np.insert(grid, normal_axis, 0.0, axis=1)


def test_frustum_distance_and_angle() -> None:
    here = look_along(np.zeros(3), np.array([1.0, 0.0, 0.0]))
    back = look_along(np.zeros(3), np.array([-1.0, 0.0, 0.0]))
    planes = np.stack(
        [
            patch((2.0, 0.0, 0.0), 0),  # ahead, frontal
            patch((6.0, 0.0, 0.0), 0),  # beyond 5 m
            patch((2.0, 0.0, -0.2), 2),  # ahead but seen at 84 degrees from its normal
            patch((0.0, 2.0, 0.0), 1),  # to the left, outside 90 degrees
            patch((0.1, 0.0, 0.0), 0),  # nearer than 0.2 m
        ]
    )
    normals = np.array([[1.0, 0, 0], [1, 0, 0], [0, 0, 1], [0, 1, 0], [1, 0, 0]])
    seen = visible_planes(planes, normals, CAMERA, np.stack([here, back]))
    np.testing.assert_array_equal(seen, [[True, False, False, False, False], [False] * 5])


def test_empty_inputs() -> None:
    assert visible_planes(np.zeros((0, 9, 3)), np.zeros((0, 3)), CAMERA, np.eye(4)[None]).shape == (1, 0)
    assert visible_planes(np.zeros((2, 9, 3)), np.zeros((2, 3)), CAMERA, np.zeros((0, 4, 4))).shape == (0, 2)
