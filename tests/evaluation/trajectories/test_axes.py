"""Conventions of axes: a camera whose right, up and forward are known, written in each of them."""

from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.trajectories.axes import AXES, begun_at, in_our_axes
from activestructure_gym.geometry import invert_rigid, look_along

# Stands at (1, 2, 1.5), looks along +x: its right is -y, its up is +z.
OURS = look_along(np.array([1.0, 2.0, 1.5]), np.array([1.0, 0.0, 0.0]))
RIGHT, UP, FORWARD, PLACE = np.array([0.0, -1, 0]), np.array([0.0, 0, 1]), np.array([1.0, 0, 0]), OURS[:3, 3]


def pose(x: np.ndarray, y: np.ndarray, z: np.ndarray, place: np.ndarray) -> np.ndarray:
    made = np.eye(4)
    made[:3] = np.stack([x, y, z, place], axis=1)
    return made


def in_habitat(vector: np.ndarray) -> np.ndarray:
    """Habitat's y is up and its -z is our y."""
    return np.array([vector[0], vector[2], -vector[1]])


WRITTEN = {
    "opencv": pose(RIGHT, -UP, FORWARD, PLACE),
    "opengl": pose(RIGHT, UP, -FORWARD, PLACE),
    "ros": pose(FORWARD, -RIGHT, UP, PLACE),
    "habitat": pose(in_habitat(RIGHT), in_habitat(UP), in_habitat(-FORWARD), in_habitat(PLACE)),
}


@pytest.mark.parametrize("axes", AXES)
def test_one_camera_written_in_every_convention_is_the_same_camera(axes: str) -> None:
    np.testing.assert_allclose(in_our_axes(WRITTEN[axes][None], axes)[0], OURS, atol=1e-15)
    inverted = in_our_axes(invert_rigid(WRITTEN[axes])[None], axes, inverted=True)
    np.testing.assert_allclose(inverted[0], OURS, atol=1e-15)


def test_an_unknown_convention_names_the_nearest() -> None:
    with pytest.raises(InputError, match="opengl"):
        in_our_axes(OURS[None], "opengll")


def test_a_trajectory_begun_elsewhere_keeps_its_motion() -> None:
    relative = np.stack([np.eye(4), pose(*np.eye(3), np.array([0.0, 0.0, 0.5]))])  # half a metre forward
    moved = begun_at(relative, OURS)
    assert moved[0].tobytes() == OURS.tobytes()
    np.testing.assert_allclose(moved[1, :3, 3], [1.5, 2.0, 1.5])
    np.testing.assert_allclose(moved[1, :3, :3], OURS[:3, :3], atol=1e-15)
