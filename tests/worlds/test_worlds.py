"""The interface of worlds: the same episode through it as through a scene, and what it refuses."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from activestructure_gym import configure
from activestructure_gym.envs import ReconstructionEnv
from activestructure_gym.errors import InputError, InputWarning
from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.ground_truth import ground_truth_of
from activestructure_gym.policies import Policy, make_env_and_policy
from activestructure_gym.reconstruction import Reconstruction
from activestructure_gym.scenes import load_scene
from activestructure_gym.sensors import RGBDSensor, SensorConfig
from activestructure_gym.worlds import Start, checked_bounds, checked_start, load_world, with_camera
from activestructure_gym.worlds.simulated_world import SimulatedRobot

WORLD = "world:simulated?scene=box&width=64&height=36"


def play(env: ReconstructionEnv, decisions: int) -> list[dict[str, Any]]:
    """The first reachable row each time; every observation and info."""
    observation, info = env.reset(seed=1)
    seen = [observation | {"info": info}]
    for _ in range(decisions):
        observation, reward, terminated, truncated, info = env.step(np.int64(0))
        seen.append(observation | {"info": info, "reward": reward})
        if terminated or truncated:
            break
    return seen


def test_a_world_gives_the_episode_that_the_scene_gives() -> None:
    robot = SimulatedRobot("box", width=64, height=36)
    robot.reset = lambda seed: None  # type: ignore[method-assign]
    start = robot.start.pose
    through_world = play(ReconstructionEnv(robot, preset="fast", frame_budget=60), 8)
    sensor = {"width": 64, "height": 36, "supersample": 1}
    options: dict[str, Any] = {"preset": "fast", "frame_budget": 60, "config": {"sensor": sensor}, "start_pose": start}
    through_scene = play(ReconstructionEnv("box?seed=0", **options), 8)
    assert len(through_world) == len(through_scene) > 4
    for one, other in zip(through_world, through_scene):
        for name in one.keys() - {"info", "reward"}:
            np.testing.assert_array_equal(one[name], other[name], err_msg=name)
        assert one["info"]["metres"] == other["info"]["metres"]
        assert one["info"]["gaussians"] == other["info"]["gaussians"]


def test_without_ground_truth_the_reward_is_known_volume_and_nothing_speaks_of_success() -> None:
    env = ReconstructionEnv(WORLD, preset="fast", frame_budget=40, reward={"known_volume": 2.0, "path": 0.0})
    seen = play(env, 10)
    volume = env.reconstruction.volume
    at_the_start = Reconstruction(env.config)
    at_the_start.start(load_world(WORLD), int(np.random.default_rng(0).integers(9)))
    info = seen[-1]["info"]
    assert info["ground_truth"] is False and "is_success" not in info and "reward/coverage" not in info
    gained = sum(one["info"]["reward/known_volume"] for one in seen)
    known = float((volume.state != 0).sum()) * volume.config.voxel_size**3
    assert 0.0 < gained < 2.0 * known
    assert gained == pytest.approx(sum(one.get("reward", 0.0) for one in seen))
    with pytest.raises(InputError, match="no ground truth"):
        _ = env.coverage


def test_a_world_with_ground_truth_is_rewarded_for_it() -> None:
    class Knowing(SimulatedRobot):
        truth = ground_truth_of(load_scene("box?seed=0"))

    info = play(ReconstructionEnv(Knowing("box", width=64, height=36), preset="fast", frame_budget=40), 4)[-1]["info"]
    assert info["reward/coverage"] >= 0.0 and "ground_truth" not in info and info["is_success"] in (True, False)


def test_any_pinhole_off_centre_and_with_two_focal_lengths() -> None:
    camera = PinholeCamera(64, 40, 40.0, 30.0, 25.0, 26.0)

    class Skewed(SimulatedRobot):
        def reset(self, seed: int) -> None:
            super().reset(seed)
            self._sensor.camera = camera

    env = ReconstructionEnv(Skewed("room"), preset="fast", frame_budget=60)
    assert env.config.sensor.camera == camera
    seen = play(env, 12)
    assert seen[-1]["depth"].shape == (40, 64)
    mapped = env.reconstruction.mapper
    psnr = mapped.keyframe_psnr()
    assert np.median(psnr) > 15.0  # a wrong principal point gives less than 12 dB
    sensor = {"width": 64, "height": 40, "intrinsics": (40.0, 30.0, 25.0, 26.0), "supersample": 1}
    drawn = RGBDSensor(load_scene("room?seed=0"), SensorConfig(**sensor), np.random.default_rng(0))  # type: ignore[arg-type]
    frame = mapped.keyframes[0]
    np.testing.assert_array_equal(drawn.capture(frame.world_from_camera).depth, frame.depth)


def test_a_robot_is_told_every_pose_of_its_path() -> None:
    class Driven(SimulatedRobot):
        paths: list[np.ndarray] = []

        def travel(self, path: np.ndarray) -> None:
            self.paths.append(path)

    robot = Driven("box", width=64, height=36)
    env = ReconstructionEnv(robot, preset="fast", frame_budget=60)
    play(env, 10)
    episode = env.reconstruction
    told = np.concatenate(robot.paths)
    np.testing.assert_array_equal(told, np.stack(episode.trajectory)[: len(told)])
    assert len(robot.paths) == len(episode.keyframe_indices)


@pytest.mark.parametrize(
    ("bounds", "message"),
    [
        ([[0, 0, 0], [1, 1, 0]], "lowest and the highest"),
        ([[0, 0, 0]], "lowest and the highest"),
        ([[0, 0, 0], [1, 1, np.inf]], "lowest and the highest"),
        ("here", "lowest and the highest"),
        ([[0, 0, 0], [1e9, 1, 1]], "within"),
    ],
)
def test_bounds_are_checked(bounds: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        checked_bounds(bounds)


def test_a_start_is_checked() -> None:
    bounds = checked_bounds([[0, 0, 0], [4, 4, 3]])
    inside = look_along(np.array([1.0, 1.0, 1.0]), np.array([1.0, 0.0, 0.0]))
    assert checked_start(Start(inside, 0.5), bounds).free_radius == 0.5
    outside = look_along(np.array([5.0, 1.0, 1.0]), np.array([1.0, 0.0, 0.0]))
    for start, message in (
        (Start(outside), "outside the world's bounds"),
        (Start(inside[:3]), "4x4"),
        (Start(2 * inside), "rigid"),
        (Start(inside, 0.0), "free_radius"),
        (Start(inside, True), "free_radius"),
    ):
        with pytest.raises(InputError, match=message):
            checked_start(start, bounds)


def test_names_of_worlds() -> None:
    assert load_world("simulated?scene=box&width=64&height=48").camera.height == 48
    with pytest.raises(InputError, match="unknown world 'simulate'.*simulated"):
        load_world("simulate")
    with pytest.raises(InputError, match="unknown option 'widht' of world 'simulated'"):
        load_world("world:simulated?widht=3")
    with pytest.raises(InputError, match="must return an object with bounds"):
        load_world("fractions:Fraction")
    with pytest.raises(InputError, match="cannot be made"):
        load_world("builtins:dict")


def test_the_environment_refuses_what_a_world_decides() -> None:
    with pytest.raises(InputError, match="leave out start_pose"):
        ReconstructionEnv(WORLD, start_pose=(1.0, 1.0, 1.0, 0.0))
    with pytest.raises(InputError, match="one world"):
        ReconstructionEnv([WORLD, "box"])
    env = ReconstructionEnv(WORLD, preset="fast")
    with pytest.raises(InputError, match="no reset options"):
        env.reset(options={"scene": "box"})
    scenes = ReconstructionEnv("box", preset="fast")
    with pytest.raises(InputError, match="when the environment is made"):
        scenes.reset(options={"scene": WORLD})


def test_a_reconstruction_needs_the_world_s_camera() -> None:
    world = load_world(WORLD)
    with pytest.raises(InputError, match="with_camera"):
        Reconstruction(configure("fast")).start(world, 0)
    config = with_camera(configure("fast"), world.camera)
    frame = Reconstruction(config).start(world, 0)
    assert isinstance(frame, Frame) and frame.camera == world.camera


class Counted(SimulatedRobot):
    """Count the worlds that are open."""

    open_worlds = 0

    def __init__(self, start: bool = True) -> None:
        super().__init__("box", width=64, height=36)
        Counted.open_worlds += 1
        self._closed, self._starts = False, start

    @property
    def start(self) -> Start:
        return super().start if self._starts else Start(np.full((4, 4), np.nan))

    def close(self) -> None:
        super().close()
        Counted.open_worlds -= not self._closed
        self._closed = True


def test_a_world_is_closed_after_every_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Counted, "open_worlds", 0)
    name = f"world:{__name__}:Counted"
    ReconstructionEnv(name, preset="rl").close()  # before the first reset
    assert Counted.open_worlds == 0
    env = ReconstructionEnv(f"{name}?start=false", preset="rl")
    with pytest.raises(InputError, match="start pose"):
        env.reset(seed=0)
    assert Counted.open_worlds == 1
    env.close()
    assert Counted.open_worlds == 0
    for options in ({"observation_keys": ["nothing"]}, {"config": {"mapper.keyframe_reduction": 5}}):
        with pytest.raises(InputError):
            ReconstructionEnv(name, preset="rl", **options)
        assert Counted.open_worlds == 0
    for limits in ("tries=0", "timeout_s=-1"):
        with pytest.raises(InputError, match="of a world"):
            load_world(f"{name}?{limits}")
        assert Counted.open_worlds == 0
    with pytest.raises(InputError, match="needs the features"):
        make_env_and_policy(Needy(), name, preset="rl", observation_keys=["action_mask"])
    assert Counted.open_worlds == 0


class Needy(Policy):
    """Fail to bind."""

    def bind(self, source: Any) -> None:
        raise InputError("Needy needs the features of another env")

    def act(self, observation: dict[str, np.ndarray]) -> int:
        return 0


def test_a_world_of_the_caller_stays_open_if_the_environment_cannot_be_made(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Counted, "open_worlds", 0)
    world = Counted()
    with pytest.raises(InputError):
        ReconstructionEnv(world, preset="rl", observation_keys=["nothing"])
    assert Counted.open_worlds == 1
    world.close()


class Distant(SimulatedRobot):
    """Have the origin of the frame 2 km away, as in a map of a town."""

    _AWAY = np.array([2000.0, 0.0, 0.0])

    def __init__(self) -> None:
        super().__init__("box", width=64, height=36)
        self.bounds = self.bounds + self._AWAY

    @property
    def start(self) -> Start:
        start = super().start
        return Start(self._moved(start.pose, self._AWAY), start.free_radius)

    def capture(self, world_from_camera: np.ndarray) -> Frame:
        frame = super().capture(self._moved(world_from_camera, -self._AWAY))
        pose = self._moved(frame.world_from_camera, self._AWAY)
        return Frame(frame.rgb, frame.depth, pose, frame.camera)

    def _moved(self, pose: np.ndarray, by: np.ndarray) -> np.ndarray:
        moved = np.array(pose)
        moved[:3, 3] += by
        return moved


def test_positions_beyond_the_limits_of_the_observation_are_warned_of() -> None:
    env = ReconstructionEnv(Distant(), preset="rl")
    with pytest.warns(
        InputWarning, match=r"the scene is 2,00\d m from the origin, and the observation limits positions"
    ):
        observation, _ = env.reset(seed=0)
    rows = observation["action_mask"] > 0
    assert (observation["candidates"][rows, 0] == 1000.0).all()  # all views seem to be at one place
    env.close()
