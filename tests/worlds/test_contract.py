"""What every world keeps to: `check_world`, a level start, and frames that need no conversion."""

from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.checks import check_world
from activestructure_gym.worlds import load_world

RANGE = 1000.0  # metres: anything beyond is no measurement
# World: fixtures that its name needs, the name with these values.
NAMES: dict[str, tuple[tuple[str, ...], str]] = {
    "simulated": ((), "simulated?scene=box&width=48&height=32"),
    "pyrender": (("mesh_room",), "pyrender?file={mesh_room}&width=48&height=32"),
    "recorded": (("recorded_box",), "recorded?path={recorded_box}&up=-y&width=48"),
    "splat": (("splat_box",), "splat?file={splat_box}&width=48&height=32"),
    "mujoco": (("mujoco_room",), "mujoco?model={mujoco_room}&width=48&height=32"),
}


@pytest.fixture(params=sorted(NAMES))
def name(request: pytest.FixtureRequest) -> str:
    fixtures, text = NAMES[request.param]
    return text.format(**{fixture: request.getfixturevalue(fixture) for fixture in fixtures})


def test_it_passes_the_check_of_worlds(name: str) -> None:
    check_world(name)


def test_its_start_is_level_and_its_frames_need_no_conversion(name: str) -> None:
    world = load_world(name)
    start, frame = world.start, world.capture(world.start.pose)
    world.close()
    np.testing.assert_allclose(start.pose[2, 0], 0.0, atol=1e-6)  # without roll
    assert 0.0 < start.free_radius < RANGE
    assert frame.camera == world.camera
    assert frame.depth.dtype == np.float32
    assert np.isfinite(frame.depth).all() and frame.depth.min() >= 0.0 and frame.depth.max() < RANGE
    assert (frame.depth > 0).mean() > 0.1
