"""Plan an apartment before meshing: floor plan, furniture positions, free space."""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np

from activestructure_gym.scenes.procedural.furniture import Light, Piece, lights_of
from activestructure_gym.scenes.procedural.furniture_placement import RoomPlanner
from activestructure_gym.scenes.procedural.layout import CEILING, UNIT, Layout, plan_layout
from activestructure_gym.scenes.procedural.room_programs import furnish_room
from activestructure_gym.scenes.procedural.room_trim import front_door, window_frames

# Metres, minimum distance of free points from walls. Skirting boards, casings and sills are up to 4 cm thick.
_FROM_WALLS = 0.05
# Metres, minimum distance of free points from furniture boxes. Handles and cushions exceed the boxes slightly.
_FROM_PIECES = 0.04


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

    def is_free(self, points: np.ndarray) -> np.ndarray:  # [N, 3] metres -> [N] bool
        """Return whether points are free: inside rooms or doorways, 5 cm from walls, outside all furniture boxes."""
        owner = self.layout.owner
        air = np.array([space.kind != "window" for space in self.layout.spaces] + [False])  # the last is for -1
        free = np.ones(len(points), dtype=bool)
        for axis in range(3):
            for step in (-_FROM_WALLS, _FROM_WALLS):
                moved = points.copy()
                moved[:, axis] += step
                cell = np.floor(moved / UNIT).astype(int)
                within = ((cell >= 0) & (cell < owner.shape)).all(axis=1)
                cell = np.clip(cell, 0, np.array(owner.shape) - 1)
                free &= within & air[owner[cell[:, 0], cell[:, 1], cell[:, 2]]]
        for piece in self.pieces:
            lower, upper = piece.box
            free &= ~((points > lower - _FROM_PIECES) & (points < upper + _FROM_PIECES)).all(axis=1)
        return free

    def free_points(self, count: int, rng: np.random.Generator) -> np.ndarray:  # [count, 3] metres
        """Return uniform random points of the free space."""
        size = np.array(self.layout.owner.shape) * UNIT
        found = np.empty((0, 3))
        while len(found) < count:
            points = rng.random((2 * count, 3)) * size
            found = np.concatenate([found, points[self.is_free(points)]])
        return found[:count]


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
