from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.geometry import look_along
from activestructure_gym.ground_truth import ground_truth_of
from activestructure_gym.ground_truth.start_check import check_start_pose
from activestructure_gym.scenes import Scene


def check(scene: Scene, pose: np.ndarray) -> None:
    check_start_pose(ground_truth_of(scene), pose, 0.45)


def test_poses_stand_free_at_eye_height_and_look_level(furnished_room):
    space = ground_truth_of(furnished_room).free_space
    poses = space.start_poses
    assert len(poses) == 16
    position, forward = poses[:, :3, 3], poses[:, :3, 2]
    assert (space.clearance_at(position) >= 0.45).all()
    down = furnished_room.raycaster.cast(position, np.tile([0.0, 0.0, -1.0], (16, 1))).distance
    assert ((down >= 1.2) & (down <= 1.5)).all()
    np.testing.assert_allclose(forward[:, 2], 0, atol=1e-9)
    np.testing.assert_allclose(poses[:, 2, 0], 0, atol=1e-9)  # no roll
    rotation = poses[:, :3, :3]
    np.testing.assert_allclose(rotation @ np.swapaxes(rotation, 1, 2), np.tile(np.eye(3), (16, 1, 1)), atol=1e-9)
    for pose in poses:
        check(furnished_room, pose)


def test_poses_are_spread_and_the_same_every_time(furnished_room):
    from activestructure_gym.ground_truth.start_poses import choose_start_poses

    space = ground_truth_of(furnished_room).free_space
    np.testing.assert_array_equal(choose_start_poses(furnished_room, space), space.start_poses)
    position = space.start_poses[:, :3, 3]
    distance = np.linalg.norm(position[:, None] - position[None], axis=-1) + 9 * np.eye(16)
    assert distance.min() > 0.3
    assert np.ptp(position[:, :2], axis=0).min() > 1.0


def test_poses_look_along_a_corridor(make_scene, make_box):
    scene = make_scene(*make_box((0, 0, 0), (1.4, 8, 2.5)), name="corridor")
    forward = ground_truth_of(scene).free_space.start_poses[:, :3, 2]
    assert (np.abs(forward[:, 1]) > 0.9).all()


def test_no_pose_stands_on_a_bed(make_scene, make_box, join):
    scene = make_scene(*join(make_box((0, 0, 0), (5, 4, 2.7)), make_box((0.1, 0.1, 0.0), (2.1, 1.7, 0.5))), name="bed")
    below = ground_truth_of(scene).free_space.start_poses[:, :3, 3]
    over_bed = ((below[:, :2] > [0.1, 0.1]) & (below[:, :2] < [2.1, 1.7])).all(axis=1)
    assert not over_bed.any()


def test_every_storey_has_poses(make_scene, make_box, join):
    """Two storeys joined by an opening in the slab; both floors count as floors."""
    lower, upper = make_box((0, 0, 0), (5, 4, 2.5)), make_box((0, 0, 2.5), (5, 4, 5.2))
    lower = lower[0], lower[1][:-2]  # without its ceiling
    upper = upper[0], upper[1][:-4]  # without floor and ceiling
    ceiling = np.array([[0, 0, 5.2], [5, 0, 5.2], [5, 4, 5.2], [0, 4, 5.2]], dtype=float)
    slab = np.array([[1.2, 0, 2.5], [5, 0, 2.5], [5, 4, 2.5], [1.2, 4, 2.5]], dtype=float)
    quads = np.array([[0, 1, 2], [0, 2, 3]])
    scene = make_scene(*join(lower, upper, (ceiling, quads), (slab, quads)), name="storeys")
    z = ground_truth_of(scene).free_space.start_poses[:, 2, 3]
    assert (z < 1.6).sum() >= 3 and (z > 3.6).sum() >= 3


def test_a_narrow_scene_is_measured_by_its_own_poses(make_scene, make_box):
    scene = make_scene(*make_box((0, 0, 0), (0.75, 6, 2.3)), name="narrow")
    poses = ground_truth_of(scene).free_space.start_poses
    assert len(poses) >= 8 and ground_truth_of(scene).free_space.clearance_at(poses[:, :3, 3]).max() < 0.45
    for pose in poses:
        check(scene, pose)
    with pytest.raises(InputError, match="from the nearest surface"):
        check(scene, look_along(np.array([0.22, 3, 1.2]), np.array([0, 1, 0])))


@pytest.mark.parametrize(
    "position, said",
    [
        ((0.5, 0.4, 1.0), "inside a wall or furniture"),  # in the wardrobe
        ((2.3, 1.6, 0.72), "inside a wall or furniture"),  # in the table's board
        ((0.0, 1.5, 1.2), "inside a wall or furniture"),  # in the wall
        ((9.0, 1.5, 1.2), "outside the scene's bounds"),
        ((2.0, 1.5, -0.4), "outside the scene's bounds"),
        ((3.7, 1.5, 1.2), "0.30 m from the nearest surface, but needs 0.45 m"),
    ],
)
def test_poses_that_are_refused(furnished_room, position, said):
    with pytest.raises(InputError) as caught:
        check(furnished_room, look_along(np.array(position), np.array([1.0, 0, 0])))
    message = str(caught.value)
    assert said in message and "nearest free start" in message and "\n" not in message


def test_matrices_that_are_no_poses(furnished_room):
    good = ground_truth_of(furnished_room).free_space.start_poses[0]
    for bad, said in (
        (np.eye(3), "4 x 4"),
        (np.full((4, 4), np.nan), "finite"),
        (good * [[2], [2], [2], [1]], "not a rotation"),
        (good @ np.diag([1.0, 1.0, -1.0, 1.0]), "not a rotation"),
    ):
        with pytest.raises(InputError, match=said):
            check(furnished_room, bad)
