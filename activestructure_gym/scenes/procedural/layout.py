"""Plan floors: rooms, doors, windows and the shell around them, on a lattice of 0.1 m.

A plan is a set of boxes of air on the lattice: one per room, one tunnel through the wall per door, one niche per
window. The shell is the boundary between air and everything else, so it is always closed.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

UNIT = 0.1  # metres per lattice step
CEILING = 27  # lattice steps: 2.7 m, a common room height in apartments
DOOR_HEAD = 21  # lattice steps: 2.1 m, height of a door
_WINDOW_SILL, WINDOW_HEAD = 9, 22  # lattice steps: lower and upper edge of a window at 0.9 m and 2.2 m
NICHE = 2  # lattice steps: 0.2 m from the inner face of an outer wall to the pane
_WALL = 1  # lattice steps between a room and its cell's border: inner walls are 0.2 m thick

RoomKind = Literal["living", "bedroom", "kitchen", "bath", "study", "child", "dining"]
# Typical floor areas of rooms in m^2, with their walls.
_AREAS: dict[RoomKind, float] = {
    "living": 21.0, "bedroom": 15.0, "kitchen": 12.5, "bath": 7.0, "study": 11.5, "child": 12.0, "dining": 13.0
}  # fmt: skip
_PROGRAMS: dict[int, tuple[RoomKind, ...]] = {
    2: ("living", "bedroom"),
    3: ("living", "bedroom", "kitchen"),
    4: ("living", "bedroom", "kitchen", "bath"),
    5: ("living", "bedroom", "kitchen", "bath", "study"),
    6: ("living", "bedroom", "kitchen", "bath", "study", "child"),
    7: ("living", "bedroom", "kitchen", "bath", "study", "child", "dining"),
}
_SINGLE: tuple[RoomKind, ...] = ("living", "bedroom", "study", "kitchen")  # selected in turn by seed for rooms=1
_PRIVATE = ("bedroom", "bath", "child")  # not used as passages if avoidable
MAX_ROOMS = max(_PROGRAMS)

Box = tuple[int, int, int, int]  # x0, y0, x1, y1 in lattice steps


@dataclass(frozen=True)
class Space:
    """Describe a box of air on the lattice: a room, a doorway or a window niche."""

    kind: RoomKind | Literal["door", "window"]
    lower: tuple[int, int, int]  # lattice steps
    upper: tuple[int, int, int]
    room: int  # index of the room itself, or of the room of a door or window (for a door, the first of two rooms)
    outward: tuple[int, int] = (0, 0)  # doors and windows: direction through the wall, out of the room

    @property
    def box(self) -> np.ndarray:  # [2, 3] metres
        """Return the lower and the upper corner of the box."""
        return np.array([self.lower, self.upper]) * UNIT


@dataclass(frozen=True)
class Layout:
    """Hold a floor plan: ``spaces`` lists all rooms first, then doorways and window niches."""

    spaces: tuple[Space, ...]
    rooms: int
    entrance: tuple[int, int, int] | None = (
        None  # room, wall (0: -y, 1: +x, 2: +y, 3: -x), step along it from its left end
    )

    @cached_property
    def owner(self) -> np.ndarray:  # [X, Y, Z] int16
        """Return the index of the space that contains each lattice cell, -1 = no air.

        The lower corner of cell (i, j, k) is at (i, j, k) * UNIT metres.
        """
        size = np.max([space.upper for space in self.spaces], axis=0) + 1
        owner = np.full(size, -1, dtype=np.int16)
        for index, space in enumerate(self.spaces):
            (a, b, c), (d, e, f) = space.lower, space.upper
            owner[a:d, b:e, c:f] = index
        return owner

    def openings(self, room: int) -> list[Space]:
        """Return the doors and windows in the walls of a room."""
        lower, upper = np.array(self.spaces[room].lower), np.array(self.spaces[room].upper)
        return [
            space
            for space in self.spaces[self.rooms :]
            if (np.array(space.lower) <= upper).all() and (np.array(space.upper) >= lower).all()
        ]


def plan_layout(rng: np.random.Generator, *, rooms: int, seed: int) -> Layout:
    """Return a floor plan with exactly ``rooms`` rooms, all connected by doors.

    A rectangle is split recursively, in proportion to the areas of the rooms on both sides. Plans with narrow or
    unreachable rooms are rejected (about half of them; the loop ends in practice).
    """
    kinds = _PROGRAMS[rooms] if rooms > 1 else (_SINGLE[seed % len(_SINGLE)],)
    while True:
        area = sum(max(_AREAS[kind], 14.0) if rooms == 1 else _AREAS[kind] for kind in kinds)
        area *= rng.uniform(0.95, 1.15) / UNIT**2
        aspect = rng.uniform(1.05, 1.4)
        width, depth = round(float(np.sqrt(area * aspect))), round(float(np.sqrt(area / aspect)))
        cells = _split((NICHE - _WALL, NICHE - _WALL, width + 1, depth + 1), list(kinds), rng)
        cells.sort(key=lambda cell: kinds.index(cell[0]))
        boxes = [(x0 + _WALL, y0 + _WALL, x1 - _WALL, y1 - _WALL) for _, (x0, y0, x1, y1) in cells]
        doors = _doors(boxes, kinds, rng) if all(map(_usable, kinds, boxes)) else None
        if doors is not None:
            break
    spaces = [Space(kind, (*box[:2], 0), (*box[2:], CEILING), i) for i, (kind, box) in enumerate(zip(kinds, boxes))]
    windows, free_walls = _windows(boxes, kinds, rng)
    entrance = None
    if free_walls:
        room, wall, length = free_walls[0]
        entrance = (room, wall, int(rng.choice([3, length - 13])))  # 0.3 m from either corner
    return Layout(tuple(spaces + doors + windows), rooms, entrance)


def _split(cell: Box, kinds: list[RoomKind], rng: np.random.Generator) -> list[tuple[RoomKind, Box]]:
    if len(kinds) == 1:
        return [(kinds[0], cell)]
    kinds = [kinds[i] for i in rng.permutation(len(kinds))]
    half = len(kinds) // 2
    first, second = kinds[:half], kinds[half:]
    share = sum(_AREAS[kind] for kind in first) / sum(_AREAS[kind] for kind in kinds) + rng.uniform(-0.03, 0.03)
    x0, y0, x1, y1 = cell
    if x1 - x0 >= y1 - y0:
        cut = x0 + round((x1 - x0) * share)
        return _split((x0, y0, cut, y1), first, rng) + _split((cut, y0, x1, y1), second, rng)
    cut = y0 + round((y1 - y0) * share)
    return _split((x0, y0, x1, cut), first, rng) + _split((x0, cut, x1, y1), second, rng)


def _usable(kind: RoomKind, box: Box) -> bool:
    """Return whether a room is wide enough for its furniture and at most twice as long as wide."""
    short, long = sorted((box[2] - box[0], box[3] - box[1]))
    least = {"bath": 19, "living": 34, "bedroom": 29}.get(kind, 27)  # decimetres
    return short >= least and long <= 2.0 * short


def _doors(boxes: list[Box], kinds: tuple[RoomKind, ...], rng: np.random.Generator) -> list[Space] | None:
    """Return door tunnels that connect all rooms; None if the rooms cannot be connected.

    They are a random spanning tree of the pairs of adjacent rooms, and a quarter of the other pairs.
    """
    pairs = []
    for i, a in enumerate(boxes):
        for j, b in enumerate(boxes[:i]):
            for axis in range(2):
                low, high = max(a[1 - axis], b[1 - axis]), min(a[3 - axis], b[3 - axis])
                touching = a[axis] - b[axis + 2] == 2 * _WALL or b[axis] - a[axis + 2] == 2 * _WALL
                # A door of 0.9 m with 0.2 m of wall on both sides.
                if touching and high - low >= 13:
                    private = (kinds[i] in _PRIVATE) + (kinds[j] in _PRIVATE)
                    pairs.append((private + rng.random(), j, i, axis, low, high))
    group = list(range(len(boxes)))
    doors = []
    for cost, j, i, axis, low, high in sorted(pairs):
        connects = group[i] != group[j]
        if not connects and (cost > 1.0 or rng.random() > 0.25):
            continue
        group = [group[j] if g == group[i] else g for g in group]
        open_plan = cost < 1.0 and high - low >= 22 and rng.random() < 0.4
        width = 16 if open_plan else int(rng.choice([9, 9, 10]))  # decimetres; 1.6 m is an open passage
        left, right = low + 2, high - 2 - width
        # Usually near a corner, which leaves long stretches of wall for furniture.
        start = int(rng.integers(left, right + 1)) if rng.random() < 0.2 else int(rng.choice([left, right]))
        near, far = (j, i) if boxes[j][axis] < boxes[i][axis] else (i, j)
        lower, upper, outward = [start, start, 0], [start + width, start + width, DOOR_HEAD], [0, 0]
        lower[axis], upper[axis], outward[axis] = boxes[near][axis + 2], boxes[far][axis], 1
        doors.append(Space("door", (*lower,), (*upper,), near, (*outward,)))  # type: ignore[arg-type]
    return doors if len(set(group)) == 1 else None


def _windows(
    boxes: list[Box], kinds: tuple[RoomKind, ...], rng: np.random.Generator
) -> tuple[list[Space], list[tuple[int, int, int]]]:
    """Return window niches in outer walls, at most two per room, and the outer walls without a window.

    A wall is (room, wall, length in lattice steps), as in `Layout.entrance`.
    """
    edge = (min(b[0] for b in boxes), min(b[1] for b in boxes), max(b[2] for b in boxes), max(b[3] for b in boxes))
    windows: list[Space] = []
    free_walls = []
    for room, box in enumerate(boxes):
        outer = [wall for wall, side in enumerate((1, 2, 3, 0)) if box[side] == edge[side]]
        count = 0
        for wall in rng.permutation(outer).astype(int):
            axis = 0 if wall in (0, 2) else 1  # axis along the wall
            length = box[axis + 2] - box[axis]
            if length < 18 or count == 2 or (count == 1 and (kinds[room] == "bath" or rng.random() < 0.5)):
                if length >= 24 and kinds[room] in ("living", "kitchen", "dining", "study"):
                    free_walls.append((room, int(wall), length))
                continue
            width = 7 if kinds[room] == "bath" else int(rng.integers(10, min(18, length - 8) + 1))  # decimetres
            start = box[axis] + int(rng.integers(5, length - width - 4)) if length - width > 10 else box[axis] + 4
            sill = 13 if kinds[room] == "bath" else _WINDOW_SILL
            lower, upper, outward = [start, start, sill], [start + width, start + width, WINDOW_HEAD], [0, 0]
            across = 1 - axis
            sign = -1 if wall in (0, 3) else 1
            inner = box[across] if sign < 0 else box[across + 2]
            lower[across], upper[across] = sorted((inner, inner + sign * NICHE))
            outward[across] = sign
            windows.append(Space("window", (*lower,), (*upper,), room, (*outward,)))  # type: ignore[arg-type]
            count += 1
    free_walls.sort(key=lambda wall: wall[0])
    return windows, free_walls
