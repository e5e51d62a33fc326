"""A mesh file drawn by pyrender, as a world."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.sensors.raycast import RaycastRenderer
from activestructure_gym.worlds import load_world
from tests.worlds.rooms import room


def test_its_frames_are_those_of_the_mesh(mesh_room: Path) -> None:
    world = load_world(f"pyrender?file={mesh_room}&width=64&height=36")
    np.testing.assert_allclose(world.bounds, room().bounds, atol=1e-5)
    frame = world.capture(world.start.pose)
    rgb, depth = RaycastRenderer(room()).render(world.camera, world.start.pose, supersample=1)
    assert (np.abs(frame.depth - depth) < 0.01).mean() > 0.99
    assert (np.abs(frame.rgb.astype(int) - rgb) < 3).mean() > 0.99
    world.close()


def test_a_file_is_needed() -> None:
    with pytest.raises(InputError, match="needs the option file"):
        load_world("pyrender")
    with pytest.raises(InputError, match="nowhere.glb"):
        load_world("pyrender?file=nowhere.glb")


def test_it_draws_in_turn_with_mujoco(mesh_room: Path, mujoco_room: Path) -> None:
    size = "width=64&height=36"
    worlds = [load_world(f"pyrender?file={mesh_room}&{size}"), load_world(f"mujoco?model={mujoco_room}&{size}&fovy=60")]
    pose = worlds[0].start.pose
    first, again = ([world.capture(pose) for world in worlds] for _ in range(2))
    for one, other in zip(first, again):
        np.testing.assert_array_equal(one.rgb, other.rgb)
        np.testing.assert_array_equal(one.depth, other.depth)
    for world in worlds:
        world.close()
