"""Trajectories that a camera can have flown, and those that a wrong convention makes of them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.trajectories.axes import AXES, in_our_axes
from activestructure_gym.evaluation.trajectories.fit import checked, fit_of, likeliest, with_w_first
from activestructure_gym.geometry import look_along
from tests.evaluation.trajectories.test_axes import in_habitat

LOW, HIGH = np.array([0.0, 0.0, 0.0]), np.array([4.0, 8.0, 2.5])  # of a room


def clearance_at(points: np.ndarray) -> np.ndarray:
    return np.minimum(points - LOW, HIGH - points).min(axis=1).clip(min=0.0)


def flown() -> np.ndarray:
    """Forty poses along the room, at eye height, a little down."""
    places = np.linspace([2.0, 1.0, 1.5], [2.0, 7.0, 1.5], 40)
    return np.stack([look_along(place, np.array([0.3, 1.0, -0.2])) for place in places])


def written(axes: str) -> np.ndarray:
    """The flight as a program with these axes writes it: what `in_our_axes` undoes."""
    poses = flown()
    turns = {"opencv": np.eye(3), "opengl": np.diag([1.0, -1, -1]), "habitat": np.diag([1.0, -1, -1])}
    turns["ros"] = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])
    poses[:, :3, :3] = poses[:, :3, :3] @ turns[axes]
    if axes == "habitat":
        poses[:, :3] = np.apply_along_axis(in_habitat, 1, poses[:, :3])
    return poses


@pytest.mark.parametrize("meant", AXES)
def test_the_convention_of_a_file_is_found(meant: str) -> None:
    poses = written(meant)
    np.testing.assert_allclose(in_our_axes(poses, meant), flown(), atol=1e-12)
    found = likeliest(clearance_at, poses)
    assert found is not None and (found.axes, found.inverted) == (meant, False)
    for axes in set(AXES) - {meant}:
        with pytest.raises(InputError, match=f"the most likely convention is --axes {meant}$"):
            checked(clearance_at, poses, in_our_axes(poses, axes), axes, False, "poses.txt")
    kept = checked(clearance_at, poses, in_our_axes(poses, meant), meant, False, "poses.txt")
    assert kept.outside == 0 and kept.upright == pytest.approx(fit_of(clearance_at, poses, meant, False).upright)


def test_world_to_camera_is_found() -> None:
    poses = np.linalg.inv(flown())
    with pytest.raises(InputError, match="--axes opencv --inverted"):
        checked(clearance_at, poses, in_our_axes(poses, "opencv"), "opencv", False, "poses.txt")


def test_a_few_poses_outside_are_counted_and_more_are_refused() -> None:
    poses = np.concatenate([flown(), flown()])
    poses[0, 0, 3] = -1.0
    assert checked(clearance_at, poses, poses, "opencv", False, "poses.txt").outside == 1
    poses[1, 0, 3] = -1.0
    with pytest.raises(InputError, match="2 of the 80 poses of 'poses.txt' are in walls.*every known convention"):
        checked(clearance_at, poses, poses, "opencv", False, "poses.txt")


def test_a_camera_that_looks_straight_down_is_no_wrong_convention() -> None:
    poses = np.stack([look_along(place, np.array([0.0, 0.0, -1.0])) for place in flown()[:, :3, 3]])
    kept = checked(clearance_at, poses, poses, "opencv", False, "poses.txt")
    assert kept.upright == pytest.approx(0.0)


def mistaken(poses: np.ndarray) -> np.ndarray:
    """The poses as they are read from a file that has its quaternions as w x y z."""
    read = poses.copy()
    xyzw = Rotation.from_matrix(poses[:, :3, :3]).as_quat()
    read[:, :3, :3] = Rotation.from_quat(np.roll(xyzw, 1, axis=1)).as_matrix()
    return read


@pytest.mark.parametrize("turned", [0.0, -90.0, 360.0])
def test_quaternions_in_the_other_order_are_told(turned: float) -> None:
    poses = flown()
    for pose, yaw in zip(poses, np.radians(np.linspace(0.0, turned, len(poses)))):
        pose[:3, :3] = look_along(np.zeros(3), np.array([np.sin(yaw), np.cos(yaw), -0.2]))[:3, :3]
    read = mistaken(poses)
    np.testing.assert_allclose(with_w_first(read), poses, atol=1e-12)
    with pytest.raises(InputError, match="is upside down or on its side; with quaternions as w x y z it is up"):
        checked(clearance_at, read, read, "opencv", False, "poses.txt", quaternions=True)
    assert checked(clearance_at, poses, poses, "opencv", False, "poses.txt", quaternions=True).outside == 0


def test_a_file_of_matrices_has_no_order_of_quaternions() -> None:
    poses = mistaken(flown())
    poses[:, :3, :3] = poses[0, :3, :3]
    kept = checked(clearance_at, poses, poses, "opencv", False, "poses.txt")
    with pytest.raises(InputError, match="w x y z"):
        checked(clearance_at, poses, poses, "opencv", False, "poses.txt", quaternions=True)
    assert kept.upright < 0.5
