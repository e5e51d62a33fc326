"""A recorded RGB-D sequence as a world: a small one that our own sensor renders, and the real ones where they are."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from activestructure_gym.envs import ReconstructionEnv
from activestructure_gym.errors import InputError, InputWarning
from activestructure_gym.geometry import look_along
from activestructure_gym.motion import levelled
from activestructure_gym.worlds import load_world
from activestructure_gym.worlds.recorded_world import RecordedWorld
from tests.worlds.recordings import COUNT, FIRST_FROM_WORLD, record, recorded_poses

ICL = Path(__file__).resolve().parents[3] / "shared" / "data" / "icl_nuim"
REDWOOD = Path(__file__).resolve().parents[3] / "shared" / "rgbd" / "redwood5"


@pytest.fixture(scope="module")
def folder(recorded_box: Path) -> Path:
    return recorded_box


def made(folder: Path, **options: object) -> RecordedWorld:
    query = "&".join(f"{key}={value}" for key, value in {"width": 0, "up": "-y", **options}.items())
    world = load_world(f"recorded?path={folder}&{query}")
    assert isinstance(world, RecordedWorld)
    return world


def in_file_axes(poses: np.ndarray) -> np.ndarray:
    """The recording's axes with -y up, made z up: x stays, z becomes y."""
    turned = poses.copy()
    turned[:, :3] = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]) @ FIRST_FROM_WORLD @ poses[:, :3]
    return turned


def test_a_capture_is_the_nearest_frame_with_its_own_pose(folder: Path) -> None:
    world, poses = made(folder), in_file_axes(recorded_poses())
    np.testing.assert_allclose(world.views.world_from_camera, poses, atol=1e-9)
    assert world.camera == world.capture(world.start.pose).camera and world.camera.width == 64
    np.testing.assert_allclose(world.start.pose, poses[0], atol=1e-9)
    for n in range(0, COUNT, 5):
        frame = world.capture(levelled(poses[n]))  # as the planner asks, without roll
        np.testing.assert_allclose(frame.world_from_camera, poses[n], atol=1e-9)
        off = poses[n].copy()
        off[:3, 3] += 0.02
        np.testing.assert_array_equal(world.capture(off).depth, frame.depth)


@pytest.mark.filterwarnings("error")
def test_a_recording_on_its_side_or_upside_down_gets_a_warning(folder: Path) -> None:
    for up in ("z", "y", "x"):
        with pytest.warns(InputWarning, match=f"not upright with up={up}: up=-y fits best"):
            made(folder, up=up)
    made(folder, up="-y")


def test_position_and_rotation_decide_together(folder: Path) -> None:
    world = made(folder)
    places = world.views.world_from_camera[:, :3, 3]
    asked = world.views.world_from_camera[0].copy()
    asked[:3, 3] = places[1] + 0.01  # at frame 1, turned as frame 0; they are 15 degrees and 0.1 m apart
    level = np.stack([levelled(pose) for pose in world.views.world_from_camera[:3]])
    apart = np.linalg.norm(level[:, :3, 3] - asked[:3, 3], axis=1)
    turned = [Rotation.from_matrix(pose[:3, :3].T @ levelled(asked)[:3, :3]).magnitude() for pose in level]
    assert world.nearest(asked) == int(np.argmin(apart + 0.1 / np.radians(10.0) * np.array(turned))) == 0


def test_roll_does_not_count(tmp_path: Path) -> None:
    place = np.array([2.0, 1.5, 1.2])
    poses = np.stack([look_along(place, np.array(ahead)) for ahead in ((1.0, 0.0, 0.0), (1.0, 0.36, 0.0))])
    poses[0, :3, :3] = poses[0, :3, :3] @ Rotation.from_euler("z", 40.0, degrees=True).as_matrix()
    world = made(record(tmp_path / "rolled", poses))
    assert world.nearest(levelled(world.views.world_from_camera[0])) == 0  # the other one is turned by 20 degrees


def test_bounds_and_free_radius_come_from_the_depth(folder: Path) -> None:
    world = made(folder)
    size = np.array([3.0, 4.0, 2.5])  # the box is 4 x 3 x 2.5 m; its x is the recording's z, here y
    extent = world.bounds[1] - world.bounds[0]
    assert (extent > size - 0.1).all() and (extent < size + 0.3).all()
    assert (world.views.free_radius == 0.4).all()  # no surface is closer than 0.9 m
    assert world.start.free_radius == world.views.free_radius[0]
    given = made(folder, bounds="-3,-1,-2,3,5,2")
    assert given.bounds.tolist() == [[-3.0, -1.0, -2.0], [3.0, 5.0, 2.0]]


def test_a_recording_close_to_a_wall(tmp_path: Path) -> None:
    poses = np.stack([look_along(np.array([x, 1.5, 1.2]), np.array([-1.0, 0.0, 0.0])) for x in (0.3, 0.25, 1.0)])
    world = made(record(tmp_path / "close", poses))
    np.testing.assert_allclose(world.views.free_radius, [0.27, 0.225, 0.4], atol=0.01)


def test_images_of_another_width_and_frames_that_are_held_out(folder: Path) -> None:
    world = made(folder, width=32, hold_out=4)
    assert (world.camera.width, world.camera.height) == (32, 24)
    held = list(world.held_out())
    assert len(held) == COUNT // 4 and len(world.views.free_radius) == COUNT - COUNT // 4
    for frame in held:
        assert frame.rgb.shape == (24, 32, 3)
        assert not np.allclose(world.capture(frame.world_from_camera).world_from_camera, frame.world_from_camera)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"up": "down"}, "unknown up axis 'down'"),
        ({"width": 65}, "width must be 0 or from 8 to the recorded 64 pixels"),
        ({"hold_out": 1}, "hold_out must be 0, or from 2 to"),
        ({"depth_scale": 0}, "depth_scale"),
        ({"bounds": "1,2,3"}, "option bounds of world .recorded. cannot be .1,2,3"),
        ({"bounds": "1,1,1,0,0,0"}, "lowest and the highest"),
    ],
)
def test_options_are_checked(folder: Path, options: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        made(folder, **options)


def test_recordings_that_cannot_be_used(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no sequence folder"):
        made(tmp_path / "gone")
    with pytest.raises(InputError, match="there is no trajectory"):
        made(tmp_path)
    broken = record(tmp_path / "broken", recorded_poses()[:3])
    (broken / "depth" / "00001.png").write_bytes(b"broken")
    with pytest.raises(InputError, match="00001.png' cannot be read as an image"):
        made(broken)
    for n in range(3):
        cv2.imwrite(str(broken / "depth" / f"{n:05d}.png"), np.zeros((48, 64), np.uint16))
    with pytest.raises(InputError, match="no depth above 0"):
        made(broken)
    (broken / "color" / "00000.png").unlink()
    with pytest.raises(InputError, match="3 poses, 2 colour and 3 depth images"):
        made(broken)


def test_an_episode_maps_recorded_frames_only(folder: Path) -> None:
    world = made(folder)
    env = ReconstructionEnv(world, preset="fast", frame_budget=60, config={"keyframe_every": 5})
    env.reset(seed=0)
    episode = env.reconstruction
    ended = False
    while not ended:
        _, _, terminated, truncated, info = env.step(0)
        ended = terminated or truncated
        assert info["reached"] or truncated
    recorded = {frame.tobytes() for frame in (world.capture(pose).depth for pose in world.views.world_from_camera)}
    assert len(episode.mapper.keyframes) >= 6
    assert {frame.depth.tobytes() for frame in episode.mapper.keyframes} <= recorded
    env.close()


@pytest.mark.slow
@pytest.mark.skipif(not ICL.is_dir(), reason="the ICL-NUIM sequence is not here")
def test_the_real_living_room() -> None:
    world = load_world(f"recorded?path={ICL}&up=-y&hold_out=8")
    assert isinstance(world, RecordedWorld) and len(world.views.free_radius) == 185
    env = ReconstructionEnv(world, preset="fast", frame_budget=60, config={"mapper.iterations": 4})
    env.reset(seed=0)
    while not env.reconstruction.exhausted and len(env.reconstruction.candidates):
        env.step(0)
    assert np.median(env.reconstruction.mapper.keyframe_psnr()) > 18.0
    env.close()


@pytest.mark.skipif(not REDWOOD.is_dir(), reason="the Redwood frames are not here")
def test_five_real_frames() -> None:
    world = load_world(f"recorded?path={REDWOOD}&up=-y&width=80")
    frame = world.capture(world.start.pose)
    assert frame.rgb.shape == (60, 80, 3) and 0.5 < (frame.depth > 0).mean() < 1.0
    assert 0.3 < world.start.free_radius <= 0.4
