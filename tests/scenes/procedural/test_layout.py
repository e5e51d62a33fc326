"""Floor plans: the right number of rooms, doors between all of them, no two spaces in one place."""

from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.scenes.procedural.furniture_placement import walls_of
from activestructure_gym.scenes.procedural.layout import CEILING, UNIT, Layout, Space, plan_layout

PLANS = [(rooms, seed) for rooms in range(1, 8) for seed in range(8)]


def plan(rooms: int, seed: int) -> Layout:
    return plan_layout(np.random.default_rng([rooms, seed]), rooms=rooms, seed=seed)


@pytest.mark.parametrize(("rooms", "seed"), PLANS)
def test_plans_keep_the_rules(rooms: int, seed: int) -> None:
    layout = plan(rooms, seed)
    spaces = layout.spaces
    assert layout.rooms == rooms
    assert [space.kind in ("door", "window") for space in spaces] == [False] * rooms + [True] * (len(spaces) - rooms)
    # Boxes of air are disjoint: the lattice holds exactly the sum of their cells.
    cells = sum(int(np.prod(np.subtract(space.upper, space.lower))) for space in spaces)
    assert cells == int((layout.owner >= 0).sum())
    # All rooms are reached through doors of at least 0.9 m.
    group = list(range(rooms))
    for door in (space for space in spaces if space.kind == "door"):
        ends = [room for room in range(rooms) if door in layout.openings(room)]
        assert len(ends) == 2
        width = max(np.subtract(door.upper, door.lower)[:2])
        assert width >= 9 and door.upper[2] == 21
        group = [group[ends[0]] if g == group[ends[1]] else g for g in group]
    assert len(set(group)) == 1
    for room in spaces[:rooms]:
        assert room.upper[2] - room.lower[2] == CEILING and room.lower[2] == 0
        assert min(room.lower[:2]) >= 1
    # The first room of a flat is the living room, and it is not small.
    if rooms > 1:
        assert spaces[0].kind == "living"
        assert np.prod(np.ptp(spaces[0].box, axis=0)[:2]) > 12.0  # m^2


def test_a_plan_is_a_function_of_its_generator() -> None:
    assert plan(5, 3) == plan(5, 3)
    assert plan(5, 3) != plan(5, 4)


def test_single_rooms_take_turns() -> None:
    assert [plan(1, seed).spaces[0].kind for seed in range(4)] == ["living", "bedroom", "study", "kitchen"]


def test_walls_by_hand() -> None:
    # One room of 4 x 3 m at (0.2, 0.2); a door of 0.9 m through the wall at high x, 0.5 m from its low end,
    # and a window of 1 m through the wall at low y, 1 m from the low x corner.
    room = Space("living", (2, 2, 0), (42, 32, 27), 0)
    other = Space("study", (44, 2, 0), (74, 32, 27), 1)
    door = Space("door", (42, 7, 0), (44, 16, 21), 0, (1, 0))
    window = Space("window", (12, 0, 9), (22, 2, 22), 0, (0, -1))
    layout = Layout((room, other, door, window), 2)
    south, east, north, west = walls_of(layout, 0)
    assert (south.length, east.length) == (pytest.approx(4.0), pytest.approx(3.0))
    assert east.openings == ((pytest.approx(0.5), pytest.approx(1.4)),)
    assert south.windows == ((pytest.approx(1.0), pytest.approx(2.0), pytest.approx(0.9)),)
    assert not (north.doors or west.doors or north.windows or south.openings)
    assert np.allclose(east.point(0.5, 0.1), [4.1, 0.7])  # 0.1 m into the room from x = 4.2
    # Seen from the study the same door is in its wall at low x, which runs from high y down: 3 - 1.4 to 3 - 0.5.
    assert walls_of(layout, 1)[3].openings == ((pytest.approx(1.6), pytest.approx(2.5)),)
    assert UNIT == 0.1
