"""Plan an apartment before meshing: floor plan and furniture positions."""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np

from activestructure_gym.scenes.procedural.furniture import Light, Piece, lights_of
from activestructure_gym.scenes.procedural.furniture_placement import RoomPlanner
from activestructure_gym.scenes.procedural.layout import CEILING, UNIT, Layout, plan_layout
from activestructure_gym.scenes.procedural.room_programs import furnish_room
from activestructure_gym.scenes.procedural.room_trim import front_door, window_frames


@dataclass(frozen=True)
class ApartmentPlan:
    """Hold the floor plan of an apartment and its pieces of furniture."""

    layout: Layout
    pieces: tuple[Piece, ...]

    @property
    def lights(self) -> list[Light]:
        """Return the lamps of all rooms; without furniture, each room has an invisible lamp below its ceiling."""
        lights = [light for piece in self.pieces for light in lights_of(piece)]
        if not any(piece.kind == "pendant" for piece in self.pieces):
            for space in self.layout.spaces[: self.layout.rooms]:
                x, y, _ = space.box.mean(axis=0)
                lights.append(Light((float(x), float(y), CEILING * UNIT - 0.6), 0.12, (1.3, 1.04, 0.75), 0.15))
        return lights


def plan_apartment(*, seed: int, rooms: int, furnished: bool) -> ApartmentPlan:
    """Return the plan of an apartment, which `make_apartment` builds; every room has its own random generator."""
    layout = plan_layout(np.random.default_rng([seed, rooms, zlib.crc32(b"layout")]), rooms=rooms, seed=seed)
    return furnish(layout, seed=seed, furnished=furnished)


def furnish(layout: Layout, *, seed: int, furnished: bool = True) -> ApartmentPlan:
    """Return a plan: the floor plan ``layout`` with window frames, front door and optional furniture from the seed."""
    pieces = window_frames(layout) + front_door(layout)
    if furnished:
        for room in range(layout.rooms):
            rng = np.random.default_rng([seed, layout.rooms, room, zlib.crc32(b"furniture")])
            pieces += furnish_room(RoomPlanner(layout, room, rng), layout.spaces[room].kind)
    return ApartmentPlan(layout, tuple(pieces))
