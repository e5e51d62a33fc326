"""Laws of rigid motions."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from activestructure_gym.geometry import (
    invert_rigid,
    look_along,
    rotation_angle,
    se3_exp,
    transform_points,
    unrounded,
)


def random_rigid(rng: np.random.Generator, count: int) -> np.ndarray:
    transforms = np.tile(np.eye(4), (count, 1, 1))
    transforms[:, :3, :3] = Rotation.random(count, rng=rng).as_matrix()
    transforms[:, :3, 3] = rng.normal(size=(count, 3))
    return transforms


def test_inverse_undoes_and_agrees_with_linear_algebra(rng: np.random.Generator) -> None:
    transforms = random_rigid(rng, 20)
    np.testing.assert_allclose(invert_rigid(transforms) @ transforms, np.tile(np.eye(4), (20, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(invert_rigid(transforms), np.linalg.inv(transforms), atol=1e-12)


def test_transforming_points_is_homogeneous_multiplication(rng: np.random.Generator) -> None:
    transform = random_rigid(rng, 1)[0]
    points = rng.normal(size=(2, 5, 3))
    homogeneous = np.concatenate([points, np.ones((2, 5, 1))], axis=-1)
    expected = np.einsum("ij,abj->abi", transform, homogeneous)[..., :3]
    np.testing.assert_allclose(transform_points(transform, points), expected, atol=1e-12)


def test_few_digits_are_taken_as_the_nearest_rotation_and_many_as_they_are(rng: np.random.Generator) -> None:
    exact = random_rigid(rng, 20)
    rounded = exact.round(3)
    rounded[5:, :, :] = exact[5:]
    given = rounded.copy()
    found = unrounded(rounded)
    assert found[5:].tobytes() == exact[5:].tobytes() and rounded.tobytes() == given.tobytes()
    products = found[:, :3, :3] @ found[:, :3, :3].transpose(0, 2, 1)
    np.testing.assert_allclose(products, np.tile(np.eye(3), (20, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(found, exact, atol=2e-3)
    np.testing.assert_array_equal(unrounded(rounded[0]), found[0])
    np.testing.assert_array_equal(found[:, :3, 3], rounded[:, :3, 3])


@pytest.mark.parametrize("direction", [(1, 0, 0), (0, -2, 0.5), (0.1, 0.2, -5), (0, 0, 1), (0, 0, -1)])
def test_look_along_is_a_rotation_without_roll(direction: tuple[float, float, float]) -> None:
    pose = look_along(np.array([1.0, 2.0, 3.0]), np.array(direction))
    np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(pose[:3, :3]) == pytest.approx(1.0)
    np.testing.assert_allclose(pose[:3, 2], np.array(direction) / np.linalg.norm(direction), atol=1e-12)
    assert pose[2, 0] == 0.0  # the image's right is horizontal
    assert pose[2, 1] <= 1e-12  # and its down does not point up


def test_look_along_by_hand() -> None:
    # Looking along +x: right is -y, down is -z.
    pose = look_along(np.zeros(3), np.array([1.0, 0.0, 0.0]))
    np.testing.assert_allclose(pose[:3, :3], [[0, 0, 1], [-1, 0, 0], [0, -1, 0]], atol=1e-12)


def test_look_along_refuses_no_direction() -> None:
    with pytest.raises(ValueError, match="length above 0"):
        look_along(np.zeros(3), np.zeros(3))


@pytest.mark.parametrize("degrees", [0.0, 1e-4, 10.0, 90.0, 179.0, 180.0])
def test_rotation_angle(degrees: float, rng: np.random.Generator) -> None:
    first = random_rigid(rng, 1)[0]
    second = first.copy()
    axis = np.array([0.6, 0.0, 0.8])
    second[:3, :3] = first[:3, :3] @ Rotation.from_rotvec(np.radians(degrees) * axis).as_matrix()
    assert np.degrees(rotation_angle(first, second)) == pytest.approx(degrees, abs=1e-5)


@pytest.mark.parametrize("scale", [1e-10, 1e-3, 1.0, 3.0])
def test_exponential_equals_the_matrix_exponential(scale: float, rng: np.random.Generator) -> None:
    tangent = scale * rng.normal(size=6)
    rho, theta = tangent[:3], tangent[3:]
    generator = np.zeros((4, 4))
    generator[:3, :3] = np.cross(np.eye(3), theta)  # the hat of theta
    generator[:3, 3] = rho
    np.testing.assert_allclose(se3_exp(tangent), expm(generator), atol=1e-10)
