"""The documented worlds against stand-ins of Habitat-Sim, Isaac Sim and ROS 2 with exactly the calls that they make.

Each stand-in draws the same room with our ray caster, from poses in its own axes and order of quaternions.
"""

from __future__ import annotations

import ast
import sys
import time
from collections.abc import Callable
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from activestructure_gym.envs import ReconstructionEnv
from activestructure_gym.geometry import PinholeCamera, invert_rigid, look_along
from activestructure_gym.scenes.scene import Scene
from activestructure_gym.sensors.raycast import RaycastRenderer
from activestructure_gym.worlds import CaptureFailed, World, is_world
from tests.conftest import ROOT
from tests.examples.test_examples import load
from tests.worlds.rooms import room

WIDTH, HEIGHT = 64, 36
OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])  # from OpenCV's camera axes
POSES = [look_along(np.array([2.0, 2.2, 1.3]), np.array(ahead)) for ahead in ((1, 0, 0), (0.3, -1, -0.4), (-1, 1, 0.2))]
Drawn = Callable[..., tuple[np.ndarray, np.ndarray]]


def module(monkeypatch: pytest.MonkeyPatch, name: str, **content: Any) -> ModuleType:
    """A module of this name in sys.modules, and its packages."""
    made = ModuleType(name)
    made.__dict__.update(content, __path__=[])
    monkeypatch.setitem(sys.modules, name, made)
    package, _, last = name.rpartition(".")
    if package:
        if package not in sys.modules:
            module(monkeypatch, package)
        setattr(sys.modules[package], last, made)
    return made


def posed(position: Any, quaternion: Any) -> np.ndarray:  # xyzw
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.from_quat(np.asarray(quaternion, float)).as_matrix(), position
    return pose


def check(world: World, *, within: float = 1e-3) -> None:
    """Its frames are the room, seen from where they say; a few decisions are played."""
    assert is_world(world)
    np.testing.assert_allclose(world.bounds, room().bounds, atol=0.06)
    rays = RaycastRenderer(room())
    for pose in POSES:
        if hasattr(world, "travel"):
            world.travel(np.stack([pose]))
        frame = world.capture(pose)
        rgb, depth = rays.render(world.camera, frame.world_from_camera, supersample=1)
        np.testing.assert_allclose(frame.world_from_camera, pose, atol=0.05)
        assert (np.abs(frame.depth - depth) < within).mean() > 0.99 and (frame.depth > 0.3).mean() > 0.9
        assert (np.abs(frame.rgb.astype(int) - rgb) < 2).mean() > 0.99
    env = ReconstructionEnv(world, preset="fast", frame_budget=30)
    env.reset(seed=0)
    for _ in range(3):
        *_, terminated, truncated, info = env.step(np.int64(0))
        if terminated or truncated:
            break
    assert info["frames"] > 3 and info["gaussians"] > 500
    env.close()
    world.close()


def test_habitat_sim(monkeypatch: pytest.MonkeyPatch) -> None:
    y_up = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])  # z up: (x, y, z) -> (x, z, -y)
    mesh = room().mesh
    turned = Scene("y up", type(mesh)(**{**vars(mesh), "vertices": (mesh.vertices @ y_up.T).astype(np.float32)}), "")
    rays, states, closed = RaycastRenderer(turned), [], []

    class Simulator:
        def __init__(self, configuration: SimpleNamespace) -> None:
            backend, (agent,) = configuration.parts
            assert backend.scene_id == "room.glb"
            self.sensors = {sensor.uuid: sensor for sensor in agent.sensor_specifications}
            assert {name: sensor.sensor_type for name, sensor in self.sensors.items()} == {"color": 1, "depth": 2}
            assert all(sensor.position == [0.0, 0.0, 0.0] for sensor in self.sensors.values())
            self.pathfinder = SimpleNamespace(
                seed=lambda seed: None,
                get_random_navigable_point=lambda: np.array([2.0, 0.0, -1.5]),
                distance_to_closest_obstacle=lambda place, reach: 0.7,
            )

        def get_active_scene_graph(self) -> Any:
            low, high = turned.bounds
            return SimpleNamespace(
                get_root_node=lambda: SimpleNamespace(cumulative_bb=SimpleNamespace(min=low, max=high))
            )

        def get_agent(self, number: int) -> Any:
            assert number == 0
            return SimpleNamespace(set_state=states.append)

        def get_sensor_observations(self) -> dict[str, np.ndarray]:
            height, width = self.sensors["color"].resolution
            camera = PinholeCamera.from_size(width, height, self.sensors["depth"].hfov)
            state = states[-1]
            rgb, depth = rays.render(camera, posed(state.position, state.rotation) @ OPENGL, supersample=1)
            return {"color": np.dstack([rgb, np.full_like(rgb[..., 0], 255)]), "depth": depth}

        def close(self) -> None:
            closed.append(1)

    sim = module(
        monkeypatch,
        "habitat_sim",
        Simulator=Simulator,
        SimulatorConfiguration=SimpleNamespace,
        CameraSensorSpec=SimpleNamespace,
        SensorType=SimpleNamespace(COLOR=1, DEPTH=2),
        Configuration=lambda backend, agents: SimpleNamespace(parts=(backend, agents)),
        AgentState=lambda position, rotation: SimpleNamespace(position=position, rotation=rotation),
    )
    sim.agent = SimpleNamespace(AgentConfiguration=lambda: SimpleNamespace(sensor_specifications=[]))  # type: ignore[attr-defined]
    world = load("worlds/habitat_sim_world").HabitatWorld("room.glb", width=WIDTH, height=HEIGHT)
    np.testing.assert_allclose(world.start.pose[:3, 3], (2.0, 1.5, 1.2))
    assert world.start.free_radius == 0.7
    check(world)
    assert closed


class OnTheCard:
    """An array of the graphics card."""

    def __init__(self, array: np.ndarray) -> None:
        self.numpy = lambda: array


def isaac_sim(monkeypatch: pytest.MonkeyPatch, *, delay: int = 3) -> SimpleNamespace:
    """Modules of Isaac Sim 6; pictures are ``delay`` updates late, and the first ones are missing."""
    rays = RaycastRenderer(room())
    told = SimpleNamespace(updates=0, poses=[np.eye(4)], loading=2, closed=False, played=False)

    def update() -> None:
        told.updates += 1
        told.loading -= 1
        told.poses.append(told.poses[-1])

    class RtxCamera:
        def __init__(self, path: str) -> None:
            assert path.startswith("/World/") and told.loading <= 0
            self.camera = SimpleNamespace(
                set_focal_lengths=lambda focal: setattr(told, "focal", focal),
                set_apertures=lambda sides: setattr(told, "apertures", sides),
                set_clipping_ranges=lambda near, far: None,
            )

        def set_world_poses(self, positions: np.ndarray, orientations: np.ndarray) -> None:
            (position,), ((w, x, y, z),) = positions, orientations
            told.poses[-1] = posed(position, (x, y, z, w))

    class CameraSensor:
        def __init__(self, camera: RtxCamera, *, resolution: tuple[int, int], annotators: list[str]) -> None:
            assert annotators == ["rgb", "distance_to_image_plane"]
            height, width = resolution
            fx, fy = width * told.focal / told.apertures[0], height * told.focal / told.apertures[1]
            self.pinhole = PinholeCamera(width, height, fx, fy, width / 2, height / 2)

        def get_data(self, annotator: str) -> tuple[OnTheCard | None, dict[str, Any]]:
            assert told.played
            if told.updates < delay + 3:
                return None, {}
            rgb, depth = rays.render(self.pinhole, told.poses[-1 - delay] @ OPENGL, supersample=1)
            image = rgb if annotator == "rgb" else np.where(depth > 0, depth, np.inf)[..., None]
            return OnTheCard(image), {}

    stage = SimpleNamespace(open_stage=lambda usd_path: None, is_stage_loading=lambda: told.loading > 0)
    app = SimpleNamespace(play=lambda commit: setattr(told, "played", commit))
    told.update = update
    module(
        monkeypatch,
        "isaacsim",
        SimulationApp=lambda options: SimpleNamespace(
            update=lambda: told.update(), close=lambda: setattr(told, "closed", True)
        ),
    )
    module(monkeypatch, "isaacsim.core.experimental.utils", stage=stage, app=app)
    module(monkeypatch, "isaacsim.sensors.experimental.rtx", CameraSensor=CameraSensor, RtxCamera=RtxCamera)
    return told


def test_isaac_sim(monkeypatch: pytest.MonkeyPatch) -> None:
    told = isaac_sim(monkeypatch)
    bounds = tuple(room().bounds.ravel())
    world = load("worlds/isaac_sim_world").IsaacWorld("x.usd", bounds, (2, 1.5, 1.2, 90), width=WIDTH, height=HEIGHT)
    np.testing.assert_allclose(world.start.pose, look_along(np.array([2, 1.5, 1.2]), np.array([0, 1, 0])), atol=1e-12)
    check(world)
    assert told.closed
    isaac_sim(monkeypatch, delay=1000)
    world = load("worlds/isaac_sim_world").IsaacWorld("x.usd", bounds, (2, 1.5, 1.2, 90))
    with pytest.raises(CaptureFailed, match="no picture in 100 updates"):
        world.capture(world.start.pose)


class Instant(int):
    """A time or duration in nanoseconds."""

    def __new__(cls, nanoseconds: int = 0, *, seconds: float = 0.0) -> Instant:
        return super().__new__(cls, nanoseconds + round(1e9 * seconds))

    @classmethod
    def from_msg(cls, stamp: SimpleNamespace) -> Instant:
        return cls(stamp.nanoseconds)


def ros2(monkeypatch: pytest.MonkeyPatch, *, depth_kind: str, color_kind: str, miss: float) -> SimpleNamespace:
    """Modules of ROS 2, with a robot that ends ``miss`` metres from the end of each path."""
    rays, camera = RaycastRenderer(room()), PinholeCamera(WIDTH, HEIGHT, 33.0, 34.0, 31.0, 19.0)
    base_from_optical = np.eye(4)
    base_from_optical[:3, :3], base_from_optical[:3, 3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]], (0.1, 0.0, 1.1)
    robot = SimpleNamespace(base=POSES[0] @ invert_rigid(base_from_optical), alive=True, paths=[], callback=None)

    def optical() -> np.ndarray:
        return robot.base @ base_from_optical

    def pictures() -> tuple[SimpleNamespace, ...]:
        stamp = SimpleNamespace(nanoseconds=time.monotonic_ns())
        header = SimpleNamespace(stamp=stamp, frame_id="camera_color_optical_frame")
        rgb, depth = rays.render(camera, optical(), supersample=1)
        rgb = rgb if color_kind == "rgb8" else rgb[..., ::-1]
        depth = np.where(depth > 0, depth, np.nan) if depth_kind == "32FC1" else np.rint(1000 * depth).astype(np.uint16)
        k = [camera.fx, 0.0, camera.cx - 0.5, 0.0, camera.fy, camera.cy - 0.5, 0.0, 0.0, 1.0]
        return (
            SimpleNamespace(header=header, encoding=color_kind, data=rgb),
            SimpleNamespace(header=header, encoding=depth_kind, data=depth),
            SimpleNamespace(header=header, width=WIDTH, height=HEIGHT, k=k),
        )

    def spin(node: Any) -> None:
        while robot.alive:
            robot.callback(*pictures())
            time.sleep(0.001)

    class Buffer:
        def lookup_transform(self, target: str, source: str, when: Instant, timeout: Instant) -> Any:
            frames = {"map": np.eye(4), "base_link": robot.base, "camera_color_optical_frame": optical()}
            found = invert_rigid(frames[target]) @ frames[source]
            x, y, z, w = Rotation.from_matrix(found[:3, :3]).as_quat()
            place = dict(zip("xyz", found[:3, 3]))
            rotation = SimpleNamespace(x=x, y=y, z=z, w=w)
            return SimpleNamespace(transform=SimpleNamespace(translation=SimpleNamespace(**place), rotation=rotation))

    class ActionClient:
        def __init__(self, node: Any, kind: type, name: str) -> None:
            assert (kind, name) == (FollowPath, "follow_path")

        def send_goal(self, goal: Any) -> None:
            assert goal.path.header.frame_id == "map" and goal.path.poses
            last = goal.path.poses[-1].pose
            place, turn = last.position, last.orientation
            robot.base = posed((place.x + miss, place.y, place.z), (turn.x, turn.y, turn.z, turn.w))
            robot.paths.append(len(goal.path.poses))

    class FollowPath:
        @staticmethod
        def Goal() -> Any:
            return SimpleNamespace(path=SimpleNamespace(header=SimpleNamespace(), poses=[]))

    class Bridge:
        def imgmsg_to_cv2(self, message: Any, desired: str) -> np.ndarray:
            assert desired in ("rgb8", "passthrough")
            return message.data[..., ::-1] if (message.encoding, desired) == ("bgr8", "rgb8") else message.data

    def registered(callback: Any) -> None:
        robot.callback = callback

    node = SimpleNamespace(get_clock=lambda: SimpleNamespace(now=lambda: Instant(time.monotonic_ns())))
    image, info = type("Image", (), {}), type("CameraInfo", (), {})
    topics: list[tuple[Any, str]] = []

    def synchronised(subscribers: list[Any], queue: int, slop: float) -> Any:
        assert [kind for kind, _ in topics] == [image, image, info] and len(subscribers) == 3
        return SimpleNamespace(registerCallback=registered)

    for name, content in {
        "rclpy": {"init": lambda: None, "create_node": lambda name: node, "spin": spin},
        "rclpy.action": {"ActionClient": ActionClient},
        "rclpy.duration": {"Duration": Instant},
        "rclpy.time": {"Time": Instant},
        "tf2_ros": {"Buffer": Buffer, "TransformListener": lambda buffer, node: None},
        "cv_bridge": {"CvBridge": Bridge},
        "geometry_msgs.msg": dict.fromkeys(("Point", "Pose", "PoseStamped", "Quaternion"), SimpleNamespace),
        "nav2_msgs.action": {"FollowPath": FollowPath},
        "sensor_msgs.msg": {"Image": image, "CameraInfo": info},
        "message_filters": {
            "Subscriber": lambda node, kind, topic: topics.append((kind, topic)),
            "ApproximateTimeSynchronizer": synchronised,
        },
    }.items():
        module(monkeypatch, name, **content)
    sys.modules["rclpy"].try_shutdown = lambda: setattr(robot, "alive", False)  # type: ignore[attr-defined]
    return robot


@pytest.mark.parametrize(("depth_kind", "color_kind", "miss"), [("32FC1", "rgb8", 0.0), ("16UC1", "bgr8", 0.03)])
def test_ros2(monkeypatch: pytest.MonkeyPatch, depth_kind: str, color_kind: str, miss: float) -> None:
    robot = ros2(monkeypatch, depth_kind=depth_kind, color_kind=color_kind, miss=miss)
    world = load("worlds/ros2_world").Ros2World(tuple(room().bounds.ravel()))
    try:
        np.testing.assert_allclose(world.start.pose, POSES[0], atol=1e-9)
        assert world.camera == PinholeCamera(WIDTH, HEIGHT, 33.0, 34.0, 31.0, 19.0)
        check(world)
    finally:
        robot.alive = False
    assert robot.paths[:3] == [1, 1, 1] and max(robot.paths) > 1  # the whole path, not its end alone


def test_ros2_without_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = ros2(monkeypatch, depth_kind="32FC1", color_kind="rgb8", miss=0.0)
    example = load("worlds/ros2_world")
    world = example.Ros2World(tuple(room().bounds.ravel()))
    robot.alive = False
    monkeypatch.setattr(example, "WAIT", Instant(seconds=0.05))
    time.sleep(0.2)  # the last pictures
    with pytest.raises(CaptureFailed, match="no pictures"):
        world.capture(POSES[0])


@pytest.mark.parametrize("name", ["habitat_sim_world", "isaac_sim_world", "mujoco_kitchen", "ros2_world"])
def test_examples_of_worlds_are_short(name: str) -> None:
    text = (ROOT / "examples" / "worlds" / f"{name}.py").read_text(encoding="utf-8")
    tree = ast.parse(text)
    code = [n for n in tree.body[1:] if not isinstance(n, ast.Import | ast.ImportFrom)]
    lines = {line for node in code for line in range(node.lineno, (node.end_lineno or 0) + 1)}
    lines -= {
        n for n, line in enumerate(text.splitlines(), start=1) if not line.strip() or line.strip().startswith("#")
    }
    assert len(lines) < 60
