"""The storey: apartments that are connected by a corridor and closed to the outside."""

from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.scenes.procedural.layout import UNIT, plan_layout
from activestructure_gym.scenes.scene import Scene
from benchmarks.floor import make_floor, with_doorway


@pytest.fixture(scope="module")
def floor() -> Scene:
    return make_floor(apartments=3, lit=False)


def along_the_corridor(floor: Scene, count: int) -> np.ndarray:  # [count, 3] metres
    """Places on the corridor's axis, which is where a ray along the building is longest."""
    depth = floor.bounds[1, 1]
    across = np.arange(3.0, floor.bounds[1, 0] - 3.0, 0.1)
    free = floor.raycaster.cast(
        np.column_stack([across, np.full((len(across), 2), 1.25)]), np.tile([0.0, 1, 0], (len(across), 1))
    )
    longest = across[free.distance > depth - 1.3 - 0.2]
    y = np.linspace(0.05, depth - 0.05, count)
    return np.column_stack([np.full(count, longest.mean()), y, np.full(count, 1.25)])


def test_every_apartment_has_a_doorway_of_90_cm_to_the_corridor(floor):
    width, depth, height = np.ptp(floor.bounds, axis=0)
    assert 20 < width < 27 and 16 < depth < 23 and height == pytest.approx(2.7)
    places = along_the_corridor(floor, 2001)
    pitch = places[1, 1] - places[0, 1]
    for side, doorways in ((-1, 2), (1, 1)):
        out = np.tile([side, 0.0, 0.0], (len(places), 1))
        reached = floor.raycaster.cast(places, out).distance
        open_ = reached > 1.2 + 0.2 - 1e-3  # half the corridor and the wall
        edges = np.flatnonzero(np.diff(open_.astype(int)))
        assert len(edges) == 2 * doorways
        np.testing.assert_allclose((edges[1::2] - edges[::2]) * pitch, 0.9, atol=2 * pitch)
        np.testing.assert_allclose(reached[~open_], 1.2, atol=1e-3)


def test_no_ray_leaves_the_building(floor):
    directions = np.random.default_rng(1).normal(size=(40_000, 3))
    hits = floor.raycaster.cast(np.repeat(along_the_corridor(floor, 2000), 20, axis=0), directions)
    assert (hits.face >= 0).all()


@pytest.mark.parametrize("side", [-1, 1])
def test_a_doorway_stands_in_the_outer_wall_of_its_room(side):
    layout, door = with_doorway(plan_layout(np.random.default_rng(5), rooms=7, seed=5), side)
    room = layout.spaces[door.room]
    assert door in layout.openings(door.room)
    assert door.upper[0] == room.lower[0] if side < 0 else door.lower[0] == room.upper[0]
    assert room.lower[1] < door.lower[1] and door.upper[1] < room.upper[1]
    assert not any(space.kind == "window" and space.outward == (side, 0) for space in layout.spaces)
    assert np.ptp(door.box, axis=0) == pytest.approx([2 * UNIT, 0.9, 2.1])


def test_a_floor_is_more_than_one_apartment():
    with pytest.raises(InputError, match="two apartments"):
        make_floor(apartments=1)
