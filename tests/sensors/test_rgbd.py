import copy
import pickle

import numpy as np
import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.geometry import look_along, rotation_angle
from activestructure_gym.sensors import RGBDSensor, SensorConfig

NOISY = SensorConfig(
    width=48, height=27, depth_noise="kinect", edge_dropout=True, pose_noise_m=0.01, pose_noise_deg=0.3
)


def sensor(scene, config, seed=0):
    return RGBDSensor(scene, config, np.random.default_rng(seed))


def same(one, other):
    parts = ("rgb", "depth", "world_from_camera")
    return all(np.array_equal(getattr(one, part), getattr(other, part)) for part in parts)


def test_frame_of_the_box_room(box_room, room_poses):
    frame = sensor(box_room, SensorConfig()).capture(room_poses[0])
    assert frame.rgb.shape == (90, 160, 3) and frame.rgb.dtype == np.uint8
    assert frame.depth.shape == (90, 160) and frame.depth.dtype == np.float32
    assert frame.camera == SensorConfig().camera and frame.camera.fx == pytest.approx(80.0)  # 90 degrees: f = width / 2
    np.testing.assert_array_equal(frame.world_from_camera, room_poses[0])
    # Every point lies on one of the six walls.
    points = frame.world_points()
    gap = np.minimum(np.abs(points), np.abs(points - [4.0, 3.0, 2.5])).min(axis=1)
    assert len(points) == 90 * 160 and gap.max() < 1e-5


def test_beyond_max_range_there_is_no_return(box_room, room_poses):
    near = sensor(box_room, SensorConfig(max_range=1.5))
    full = sensor(box_room, SensorConfig())
    for pose in room_poses:
        depth = full.capture(pose).depth
        np.testing.assert_array_equal(near.capture(pose).depth, np.where(depth <= 1.5, depth, 0.0))


def test_max_range_holds_with_noise_too(box_room, room_poses):
    noisy = sensor(box_room, SensorConfig(max_range=1.5, depth_noise="kinect", noise_multiplier=5.0))
    assert all(noisy.capture(pose).depth.max() <= 1.5 for pose in room_poses)


def test_same_seed_same_frames(cluttered_room, room_poses):
    first, second, other = (sensor(cluttered_room, NOISY, seed) for seed in (1, 1, 2))
    for pose in room_poses[:3]:
        frame = first.capture(pose)
        assert same(frame, second.capture(pose))
        assert not same(frame, other.capture(pose))


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda s: pickle.loads(pickle.dumps(s))])
def test_a_copy_goes_on_where_the_original_was(cluttered_room, room_poses, duplicate):
    original = sensor(cluttered_room, NOISY)
    original.capture(room_poses[0])
    twin = duplicate(original)
    assert same(original.capture(room_poses[1]), twin.capture(room_poses[1]))


def test_a_wall_ahead_has_no_holes_whatever_its_noise(box_room):
    ahead = look_along(np.array([2.0, 1.5, 1.25]), np.array([1.0, 0.0, 0.0]))
    config = SensorConfig(width=640, height=360, horizontal_fov_deg=40.0, depth_noise="kinect", edge_dropout=True)
    assert (sensor(box_room, config).capture(ahead).depth > 0).all()


def test_pose_noise_is_on_the_report_and_not_in_the_picture(cluttered_room, room_poses):
    exact = sensor(cluttered_room, SensorConfig(width=48, height=27)).capture(room_poses[0])
    config = SensorConfig(width=48, height=27, pose_noise_m=0.05, pose_noise_deg=2.0)
    noisy = sensor(cluttered_room, config).capture(room_poses[0])
    np.testing.assert_array_equal(noisy.rgb, exact.rgb)
    np.testing.assert_array_equal(noisy.depth, exact.depth)
    assert 0 < np.linalg.norm(noisy.world_from_camera[:3, 3] - room_poses[0][:3, 3]) < 0.5
    assert 0 < rotation_angle(noisy.world_from_camera, room_poses[0]) < np.radians(20)


def test_reported_pose_is_not_the_callers_array(box_room, room_poses):
    pose = room_poses[0].copy()
    frame = sensor(box_room, SensorConfig(width=8, height=8)).capture(pose)
    pose[0, 3] = 99.0
    np.testing.assert_array_equal(frame.world_from_camera, room_poses[0])


def test_the_name_of_the_renderer_in_use(box_room):
    made = sensor(box_room, SensorConfig())
    assert made.backend == "raycast"
    made.close()
    made.close()


@pytest.mark.parametrize(
    "wrong",
    [
        np.eye(3),
        np.diag([1.0, 1.0, -1.0, 1.0]),
        2.0 * np.eye(4),
        np.full((4, 4), np.nan),
        np.eye(4) + np.eye(4, k=-3),
        *(np.where(np.arange(16).reshape(4, 4) == entry, np.nan, np.eye(4)) for entry in range(16)),
    ],
)
def test_a_pose_must_be_a_rigid_motion(box_room, wrong):
    with pytest.raises(ValueError, match="world_from_camera must be"):
        sensor(box_room, SensorConfig()).capture(wrong)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"width": 0}, "sensor width must be a whole number from 1 to 8192, got 0"),
        ({"height": 90.5}, "sensor height must be a whole number"),
        ({"width": True}, "sensor width must be a whole number"),
        ({"width": 10**6}, "sensor width must be a whole number from 1 to 8192"),
        ({"supersample": 0}, "sensor supersample must be a whole number from 1 to 16"),
        ({"horizontal_fov_deg": 180.0}, "horizontal_fov_deg must be a number from 0.1 to 179, got 180.0"),
        ({"horizontal_fov_deg": "90"}, "sensor horizontal_fov_deg must be a number from 0.1 to 179, got '90'"),
        ({"max_range": 0.0}, "sensor max_range must be a number from 0.01 to 1000, got 0.0"),
        ({"max_range": float("nan")}, "sensor max_range must be a number from 0.01 to 1000, got nan"),
        ({"backend": "opengl"}, "unknown sensor backend 'opengl'. Known: auto, pyrender, raycast"),
        ({"depth_noise": "kinnect"}, "unknown depth noise 'kinnect'; did you mean 'kinect'"),
        ({"noise_multiplier": -1.0}, "sensor noise_multiplier must be a number from 0 to 1000, got -1"),
        ({"edge_dropout": "no"}, "sensor edge_dropout must be True or False, got 'no'"),
        ({"pose_noise_m": -0.1}, "sensor pose_noise_m must be a number from 0 to 100, got -0.1"),
        ({"pose_noise_deg": float("inf")}, "sensor pose_noise_deg must be a number from 0 to 180, got inf"),
    ],
)
def test_wrong_settings_are_refused_at_construction(change, message):
    with pytest.raises(InputError) as caught:
        SensorConfig(**change)
    assert message in str(caught.value)


@pytest.mark.parametrize("size", [(1600, 100), (100, 801)])
def test_an_image_that_no_run_could_be_read_with_is_refused(size):
    with pytest.raises(InputError, match=f"at most 8 times the shorter one, got {size[0]} x {size[1]} pixels"):
        SensorConfig(width=size[0], height=size[1])
    SensorConfig(width=800, height=100)
