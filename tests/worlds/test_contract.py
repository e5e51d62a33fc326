"""What every world keeps to: the size of its frames, metres, rigid poses, and equal frames from equal options."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from activestructure_gym.worlds import World, checked_bounds, checked_pose, checked_start, is_world, load_world

RANGE = 1000.0  # metres: anything beyond is no measurement
# World: fixtures that its name needs, the name with these values.
NAMES: dict[str, tuple[tuple[str, ...], str]] = {
    "simulated": ((), "simulated?scene=box&width=48&height=32"),
    "pyrender": (("mesh_room",), "pyrender?file={mesh_room}&width=48&height=32"),
    "recorded": (("recorded_box",), "recorded?path={recorded_box}&up=-y&width=48"),
    "splat": (("splat_box",), "splat?file={splat_box}&width=48&height=32"),
    "mujoco": (("mujoco_room",), "mujoco?model={mujoco_room}&width=48&height=32"),
}


@pytest.fixture(params=sorted(NAMES), scope="module")
def name(request: pytest.FixtureRequest) -> str:
    fixtures, text = NAMES[request.param]
    return text.format(**{fixture: request.getfixturevalue(fixture) for fixture in fixtures})


@pytest.fixture(scope="module")
def world(name: str) -> Iterator[World]:
    made = load_world(name)
    yield made
    made.close()


def test_it_says_where_it_is(world: World) -> None:
    assert is_world(world)
    bounds = checked_bounds(world.bounds)
    start = checked_start(world.start, bounds)
    np.testing.assert_allclose(start.pose[2, 0], 0.0, atol=1e-6)  # without roll
    assert 0.0 < start.free_radius < RANGE


def test_its_frames_are_those_of_its_camera(world: World) -> None:
    camera, pose = world.camera, world.start.pose
    for _ in range(2):  # the start pose can be captured again
        frame = world.capture(pose)
        assert frame.camera == camera
        assert frame.rgb.shape == (camera.height, camera.width, 3) and frame.rgb.dtype == np.uint8
        assert frame.depth.shape == (camera.height, camera.width) and frame.depth.dtype == np.float32
        assert np.isfinite(frame.depth).all() and frame.depth.min() >= 0.0 and frame.depth.max() < RANGE
        assert (frame.depth > 0).mean() > 0.1
        taken = checked_pose("a frame's pose", frame.world_from_camera)
        assert np.linalg.norm(taken[:3, 3] - pose[:3, 3]) < 0.5


def test_two_fresh_worlds_give_equal_frames(name: str) -> None:
    frames = []
    for _ in range(2):
        world = load_world(name)
        pose = world.start.pose
        frames.append((world.capture(pose), world.start.free_radius))
        world.close()
        world.close()
    (one, clearance), (other, equal) = frames
    assert clearance == equal
    np.testing.assert_array_equal(one.rgb, other.rgb)
    np.testing.assert_array_equal(one.depth, other.depth)
    np.testing.assert_array_equal(one.world_from_camera, other.world_from_camera)
