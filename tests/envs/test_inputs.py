"""What users give an environment: start poses of every form."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from activestructure_gym.envs import ReconstructionEnv
from activestructure_gym.envs.inputs import as_pose, as_truth
from activestructure_gym.errors import InputError
from activestructure_gym.geometry import look_along
from activestructure_gym.motion import is_level


def test_as_pose() -> None:
    np.testing.assert_array_equal(as_pose(np.eye(4)), np.eye(4))
    np.testing.assert_allclose(as_pose((1, 2, 3, 0))[:3, 2], (1, 0, 0), atol=1e-12)


ROUNDED = np.array([[0.5, 0, 0.866, 2], [-0.866, 0, 0.5, 1.5], [0, -1, 0, 1.4], [0, 0, 0, 1]])


def test_a_pose_written_with_three_decimals_is_the_nearest_rotation() -> None:
    rotation = as_pose(ROUNDED)[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(rotation, ROUNDED[:3, :3], atol=1e-4)
    np.testing.assert_array_equal(as_pose(ROUNDED)[:3, 3], ROUNDED[:3, 3])


def test_any_pose_written_with_three_decimals_is_accepted() -> None:
    for direction in np.random.default_rng(0).standard_normal((200, 3)):
        written = look_along(np.array([2, 1.5, 1.25]), direction).round(3)
        rotation = as_pose(written)[:3, :3]
        assert np.abs(rotation @ rotation.T - np.eye(3)).max() < 1e-12 and is_level(as_pose(written))


def test_a_pitched_pose_written_with_few_decimals_is_no_rolling_one(box_options: dict[str, Any]) -> None:
    level = look_along(np.array([2, 1.5, 1.25]), np.array([0.7, 0.4, -0.3]))
    for digits in (3, 4):
        written = np.round(level, digits)
        assert is_level(as_pose(written))
        env = ReconstructionEnv(**box_options, start_pose=written)
        env.reset(seed=0)
        np.testing.assert_allclose(env.reconstruction.pose, level, atol=2e-3)
        reconstruction = env.reconstruction
        reconstruction.start(as_truth("box"), 0, written)  # without the env
        np.testing.assert_array_equal(reconstruction.pose, as_pose(written))


def test_a_pose_of_the_callers_stays_the_callers(box_options: dict[str, Any]) -> None:
    given = ROUNDED.copy()
    env = ReconstructionEnv(**box_options, start_pose=given)
    given[:3, 3] = 1.0
    assert env.reset(seed=0)[0]["pose"][:3] == pytest.approx(ROUNDED[:3, 3])
    assert as_pose(given) is not given


def test_a_matrix_that_is_no_rigid_motion_is_refused_by_its_last_row(box_options: dict[str, Any]) -> None:
    given = np.eye(4)
    given[3, 3] = 2.0
    with pytest.raises(InputError, match=r"last row of a start pose's 4x4 matrix is \(0, 0, 0, 1\), got"):
        ReconstructionEnv(**box_options, start_pose=given).reset(seed=0)
