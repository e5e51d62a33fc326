"""Furniture keeps apart, keeps off the doors and leaves ways through the room."""

from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.scenes.procedural.apartment_plan import ApartmentPlan, plan_apartment
from activestructure_gym.scenes.procedural.furniture_placement import RoomPlanner, overlap, walls_of
from activestructure_gym.scenes.procedural.layout import Layout, Space

# Pushed under one another on purpose.
TOGETHER = [{"chair", "dining table"}, {"desk", "office chair"}]
LYING = ("rug", "mat")


@pytest.fixture(scope="module", params=[(1, 0), (1, 1), (3, 0), (4, 2), (7, 1)], ids=str)
def plan(request: pytest.FixtureRequest) -> ApartmentPlan:
    rooms, seed = request.param
    return plan_apartment(seed=seed, rooms=rooms, furnished=True)


def test_nothing_stands_in_anything_else(plan: ApartmentPlan) -> None:
    pieces = [p for p in plan.pieces if p.kind not in LYING]
    boxes = [piece.box for piece in pieces]
    for i, first in enumerate(pieces):
        for j in range(i):
            if {first.kind, pieces[j].kind} not in TOGETHER:
                common = np.minimum(boxes[i][1], boxes[j][1]) - np.maximum(boxes[i][0], boxes[j][0])
                # 2 cm: splash backs and curtain rods touch what they belong to.
                assert common.min() < 0.02, (first.kind, pieces[j].kind)


def test_everything_is_inside_one_room_and_off_the_doors(plan: ApartmentPlan) -> None:
    layout = plan.layout
    rooms = [space.box for space in layout.spaces[: layout.rooms]]
    for piece in plan.pieces:
        if piece.kind == "window frame":
            continue
        lower, upper = piece.box
        inside = [(lower > box[0] - 1e-6).all() and (upper < box[1] + 1e-6).all() for box in rooms]
        assert sum(inside) == 1, piece.kind
        if piece.kind in ("front door", "pendant", *LYING):
            continue
        for wall in walls_of(layout, inside.index(True)):
            for start, end in wall.doors:
                front = wall.rect(start, end, 0.0, 0.85)  # metres people need to come in
                footprint = (lower[0], lower[1], upper[0], upper[1])
                assert not overlap(front, footprint), (piece.kind, wall.index)


def test_rooms_have_what_their_kind_needs() -> None:
    needed = {"living": "sofa", "bedroom": "bed", "kitchen": "kitchen run", "bath": "toilet", "study": "desk"}
    found = {kind: 0 for kind in needed}
    plans = [plan_apartment(seed=seed, rooms=5, furnished=True) for seed in range(6)]
    for plan in plans:
        for kind, piece in needed.items():
            found[kind] += any(p.kind == piece for p in plan.pieces)
    assert all(count >= 5 for count in found.values()), found


def test_unfurnished_flats_hold_only_doors_and_windows() -> None:
    plan = plan_apartment(seed=0, rooms=4, furnished=False)
    assert {piece.kind for piece in plan.pieces} <= {"window frame", "front door"}
    assert len(plan.lights) == 4


def room_with_two_doors() -> RoomPlanner:
    """4 x 3 m; doors in the middle of both short walls."""
    room = Space("living", (0, 0, 0), (40, 30, 27), 0)
    doors = [Space("door", (-2, 10, 0), (0, 20, 21), 0, (-1, 0)), Space("door", (40, 10, 0), (42, 20, 21), 0, (1, 0))]
    return RoomPlanner(Layout((room, *doors), 1), 0, np.random.default_rng(0))


def test_a_wall_of_furniture_blocks_the_way_and_a_gap_opens_it() -> None:
    planner = room_with_two_doors()
    assert planner.passable()
    assert not planner.passable([(1.8, 0.0, 2.2, 3.0)])
    assert not planner.passable([(1.8, 0.0, 2.2, 2.7)])  # 0.3 m is no passage
    assert planner.passable([(1.8, 0.0, 2.2, 2.2)])  # 0.8 m is one


def test_spots_keep_clear_of_doors_and_furniture() -> None:
    planner = room_with_two_doors()
    spots = planner.wall_spots((1.0, 0.5, 2.0), front=0.6)
    assert spots
    for spot in spots:
        assert not any(overlap(spot.footprint, r) for r in planner.clear)
    planner.try_at_wall("wardrobe", (3.0, 0.6, 2.0), front=0.6)
    taken = planner.solid[-1]
    assert all(not overlap(spot.footprint, taken) for spot in planner.wall_spots((1.0, 0.5, 2.0), front=0.6))
    # Nothing 5 m wide has a place here, and trying changes nothing.
    before = len(planner.pieces)
    assert planner.try_at_wall("shelf", (5.0, 0.3, 1.9)) is None
    assert len(planner.pieces) == before


def test_roomiest_is_the_middle_of_an_empty_room() -> None:
    planner = room_with_two_doors()
    planner.clear.clear()
    middle = planner.roomiest(1.0, 1.0, margin=0.5)
    assert middle == (pytest.approx(1.5, abs=0.51), pytest.approx(1.5, abs=0.06))
    assert planner.roomiest(1.0, 1.0, margin=1.2) is None
    assert planner.roomiest(9.0, 1.0, margin=0.0) is None
