import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from activestructure_gym.geometry.rotations import quaternions


@pytest.mark.parametrize("canonical", [False, True])
def test_they_are_those_of_scipy_to_the_last_digit(canonical):
    rng = np.random.default_rng(0)
    signed = [np.diag([a, b, a * b]) for a in (-1.0, 1.0) for b in (-1.0, 1.0)]  # half turns have exact zeros
    exact = np.array(signed)[:, [1, 2, 0]]
    drawn = Rotation.random(2000, rng).as_matrix()
    rotations = np.concatenate([signed, exact, drawn[:1000] @ drawn[1000:]])
    expected = Rotation.from_matrix(rotations).as_quat(scalar_first=True, canonical=canonical)
    found = quaternions(rotations, canonical=canonical)
    assert found.tobytes() == expected.tobytes()
    assert not canonical or (found[:, 0] >= 0).all()


def test_a_matrix_that_is_nearly_a_rotation_becomes_the_one_that_is_near():
    rotations = Rotation.random(5, np.random.default_rng(1)).as_matrix() + 1e-6
    expected = Rotation.from_matrix(rotations).as_quat(scalar_first=True)
    np.testing.assert_array_equal(quaternions(rotations), expected)


def test_a_mirror_has_none():
    with pytest.raises(ValueError, match="determinant"):
        quaternions(np.diag([1.0, 1.0, -1.0])[None])
