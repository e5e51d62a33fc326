"""Captures that are stored: an episode goes on where it was interrupted, and is replayed without its world."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from activestructure_gym.envs import ReconstructionEnv
from activestructure_gym.errors import InputError
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.worlds import CaptureFailed, StoredCaptures, Views
from activestructure_gym.worlds.simulated_world import SimulatedRobot


class Breaking(SimulatedRobot):
    """Its battery ends after some captures."""

    left = 5

    def capture(self, world_from_camera: np.ndarray) -> Frame:
        self.left -= 1
        if self.left < 0:
            raise CaptureFailed("the battery is empty")
        return super().capture(world_from_camera)


def robot(kind: type[SimulatedRobot] = SimulatedRobot) -> Any:
    return kind("box", width=64, height=36, depth_noise="kinect", pose_noise_m=0.01)


def played(world: Any) -> tuple[list[dict[str, Any]], ReconstructionEnv]:
    env = ReconstructionEnv(world, preset="fast", frame_budget=60)
    seen = [env.reset(seed=3)[0]]
    ended = False
    while not ended:
        observation, _, terminated, truncated, _ = env.step(np.int64(0))
        seen.append(observation)
        ended = terminated or truncated
    return seen, env


class Forgetful(SimulatedRobot):
    def capture(self, world_from_camera: np.ndarray) -> Frame:
        return None  # type: ignore[return-value]


def test_a_capture_without_a_frame_is_told(tmp_path: Path) -> None:
    for world in (StoredCaptures(tmp_path, robot(Forgetful)), robot(Forgetful)):
        with pytest.raises(InputError, match="capture.. of Forgetful must return a Frame.*got None"):
            played(world)
    assert not list(tmp_path.glob("*.npz"))


def test_an_interrupted_episode_goes_on_as_if_nothing_had_happened(tmp_path: Path) -> None:
    whole, env = played(robot())
    with pytest.raises(CaptureFailed, match="battery"):
        played(StoredCaptures(tmp_path / "a", robot(Breaking)))
    stored = StoredCaptures(tmp_path / "a")
    assert stored.stored == 9  # five frames, and four failures in a row
    assert [path.name for path in sorted((tmp_path / "a").glob("*.failed"))][0] == "000005.failed"
    with pytest.raises(CaptureFailed, match="battery"):  # a replay fails in the same way
        played(stored)

    fresh = robot()
    asked = list[np.ndarray]()
    take = fresh.capture
    fresh.capture = lambda pose: (asked.append(pose), take(pose))[1]
    for _ in range(5):  # the noise of the real sensor would go on too
        fresh.capture(fresh.start.pose)
    asked.clear()
    again, other = played(StoredCaptures(tmp_path / "a", fresh))
    assert len(asked) == len(other.reconstruction.keyframe_indices) - 5 > 0
    assert len(again) == len(whole)
    np.testing.assert_array_equal(np.stack(other.reconstruction.trajectory)[0], env.reconstruction.trajectory[0])
    for one, two in zip(again[:3], whole[:3]):
        for name in one:
            np.testing.assert_array_equal(one[name], two[name], err_msg=name)


def test_a_stored_episode_is_replayed_without_its_world(tmp_path: Path) -> None:
    whole, env = played(StoredCaptures(tmp_path, robot()))
    replayed, other = played(StoredCaptures(tmp_path))
    assert len(whole) == len(replayed) > 3
    for one, two in zip(whole, replayed):
        for name in one:
            np.testing.assert_array_equal(one[name], two[name], err_msg=name)
    np.testing.assert_array_equal(np.stack(env.reconstruction.trajectory), np.stack(other.reconstruction.trajectory))


def test_a_robot_does_not_travel_to_what_is_stored(tmp_path: Path) -> None:
    camera, sent = robot(), list[int]()
    camera.travel = lambda path: sent.append(len(path))
    world = StoredCaptures(tmp_path, camera)
    pose = world.start.pose
    for length in (1, 2):
        world.travel(np.stack([pose] * length))
        world.capture(pose)
    again = StoredCaptures(tmp_path, camera)
    for length in (1, 2, 3):
        again.travel(np.stack([pose] * length))
        again.capture(pose)
    assert sent == [1, 2, 3]


def test_other_settings_ask_for_other_poses_and_are_refused(tmp_path: Path) -> None:
    played(StoredCaptures(tmp_path, robot()))
    env = ReconstructionEnv(StoredCaptures(tmp_path), preset="fast", frame_budget=60)
    env.reset(seed=3)
    with pytest.raises(InputError, match="another pose"):
        env.step(np.int64(3))
    with pytest.raises(CaptureFailed, match="asks for another one"):
        longer = ReconstructionEnv(StoredCaptures(tmp_path), preset="fast", frame_budget=90)
        longer.reset(seed=3)
        for _ in range(30):
            longer.step(np.int64(0))


def test_the_seed_reaches_the_world_until_a_capture_is_stored(tmp_path: Path) -> None:
    expected = robot()
    expected.reset(5)
    world = StoredCaptures(tmp_path, robot())
    assert world.bounds.shape == (2, 3) and not np.array_equal(world.start.pose, expected.start.pose)  # both are stored
    for again in (world, StoredCaptures(tmp_path, robot())):
        again.reset(5)
        np.testing.assert_array_equal(again.start.pose, expected.start.pose)
    world.capture(world.start.pose)
    world.reset(6)
    np.testing.assert_array_equal(world.start.pose, expected.start.pose)


def test_damaged_captures_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no captures to replay"):
        StoredCaptures(tmp_path)
    played(StoredCaptures(tmp_path, robot()))
    third = (tmp_path / "000002.npz").read_bytes()
    (tmp_path / "000002.npz").unlink()
    for world in (None, robot()):
        with pytest.raises(InputError, match="no capture 2, but later ones"):
            StoredCaptures(tmp_path, world)
    (tmp_path / "000002.npz").write_bytes(third[:2])
    with pytest.raises(InputError, match=r"000002.npz' is damaged.*delete it"):
        played(StoredCaptures(tmp_path))
    (tmp_path / "world.json").write_text('{"format": 9}')
    with pytest.raises(InputError, match="format 9"):
        StoredCaptures(tmp_path)
    (tmp_path / "world.json").write_text("[")
    with pytest.raises(InputError, match="damaged"):
        StoredCaptures(tmp_path)


def test_the_views_of_a_world_are_stored_too(tmp_path: Path) -> None:
    poses = np.stack([SimulatedRobot("room")._space.start_poses[k] for k in range(3)])
    first = SimulatedRobot("room", width=64, height=36)
    first.views = Views(poses, np.full(3, 0.4))  # type: ignore[attr-defined]
    world = StoredCaptures(tmp_path, first)
    world.capture(world.start.pose)
    again = StoredCaptures(tmp_path)
    assert again.views is not None
    np.testing.assert_array_equal(again.views.world_from_camera, poses)
    assert again.views.free_radius.tolist() == [0.4] * 3


class Bumping(SimulatedRobot):
    """Fail the second travel."""

    travelled = 0

    def travel(self, path: np.ndarray) -> None:
        self.travelled += 1
        if self.travelled == 2:
            raise CaptureFailed("the bumper was hit")


def test_a_failed_travel_is_replayed_as_one(tmp_path: Path) -> None:
    whole, env = played(StoredCaptures(tmp_path, robot(Bumping)))
    assert (tmp_path / "000001.failed").read_text() == "the bumper was hit"
    for again, other in (played(StoredCaptures(tmp_path)), played(StoredCaptures(tmp_path, robot()))):
        assert len(again) == len(whole)
        poses = [np.stack(one.reconstruction.trajectory) for one in (other, env)]
        np.testing.assert_array_equal(*poses)
