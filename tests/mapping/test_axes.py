from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from activestructure_gym.mapping import GaussianMap
from activestructure_gym.mapping.axes import FILE_FROM_WORLD, turned_map
from activestructure_gym.mapping.gaussian_map import ROWS


@pytest.fixture
def gaussians(rng) -> GaussianMap:
    result = GaussianMap(40)
    result.append(rng.normal(size=(ROWS, 40)).astype(np.float32))
    return result


def covariances(gaussians: GaussianMap) -> np.ndarray:  # [N, 3, 3]
    axes = Rotation.from_quat(np.roll(gaussians.quaternions, -1, axis=1)).as_matrix() * gaussians.scales[:, None, :]
    return axes @ axes.transpose(0, 2, 1)


@pytest.mark.parametrize("up, axis, sign", [("z", 2, 1), ("y", 1, 1), ("-y", 1, -1)])
def test_up_becomes_the_named_axis(gaussians, up, axis, sign):
    rotation = FILE_FROM_WORLD[up]
    np.testing.assert_array_equal(rotation @ (0, 0, 1), sign * np.eye(3)[axis])
    assert np.linalg.det(rotation) == pytest.approx(1.0)  # nothing is mirrored
    turned = turned_map(gaussians, rotation)
    np.testing.assert_array_equal(turned.means[:, axis], sign * gaussians.means[:, 2])
    np.testing.assert_allclose(
        covariances(turned), rotation @ covariances(gaussians) @ rotation.T, atol=1e-4, rtol=1e-4
    )
    np.testing.assert_array_equal(turned.parameters[7:, :40], gaussians.parameters[7:, :40])  # sizes, opacity, colour


@pytest.mark.parametrize("up", FILE_FROM_WORLD)
def test_there_and_back_is_the_map_that_was(gaussians, up):
    rotation = FILE_FROM_WORLD[up]
    back = turned_map(turned_map(gaussians, rotation), rotation.T)
    np.testing.assert_array_equal(back.means, gaussians.means)
    np.testing.assert_allclose(back.quaternions, gaussians.quaternions, atol=1e-6)


def test_an_empty_map():
    assert turned_map(GaussianMap(1), np.eye(3)).count == 0
