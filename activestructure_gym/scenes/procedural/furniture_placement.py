"""Place furniture in a room, along and on walls or in the middle, without overlaps and blocked doors."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from activestructure_gym.scenes.procedural.furniture import Piece
from activestructure_gym.scenes.procedural.furniture_storage import Size
from activestructure_gym.scenes.procedural.layout import UNIT, Layout

Rect = tuple[float, float, float, float]  # x0, y0, x1, y1 in metres

GAP = 0.04  # metres between pieces, and between a piece and its wall
DOOR_CLEARANCE = 0.9  # metres kept free in front of a door
PASSAGE = 0.6  # metres: minimum width of passages between pieces
_GRID = 0.1  # metres: resolution of the passage test


@dataclass(frozen=True)
class Wall:
    """Describe one wall of a room. ``along`` runs counter-clockwise around the room, with the room on its left."""

    index: int  # 0: low y, 1: high x, 2: high y, 3: low x
    start: np.ndarray  # [2] metres, the corner at along = 0
    along: np.ndarray  # [2] unit
    inward: np.ndarray  # [2] unit
    length: float  # metres
    openings: tuple[tuple[float, float], ...]  # doorways: start and end along the wall in metres
    doors: tuple[tuple[float, float], ...]  # doorways and the front door, if it is in this wall
    windows: tuple[tuple[float, float, float], ...]  # start and end along the wall, and height of the sill, in metres

    @property
    def yaw(self) -> float:
        """Return the yaw in radians of a piece with its back at this wall."""
        return self.index * np.pi / 2

    def point(self, along: float, away: float) -> np.ndarray:  # [2]
        """Return the point (metres, world) ``along`` metres along the wall and ``away`` metres from it."""
        return self.start + along * self.along + away * self.inward

    def rect(self, start: float, end: float, near: float, far: float) -> Rect:
        """Return the rectangle from ``start`` to ``end`` along the wall and from ``near`` to ``far`` away from it."""
        a, b = self.point(start, near), self.point(end, far)
        return (min(a[0], b[0]), min(a[1], b[1]), max(a[0], b[0]), max(a[1], b[1]))


@dataclass(frozen=True)
class Spot:
    """Describe a position at a wall where a piece fits."""

    wall: Wall
    centre: float  # metres along the wall
    footprint: Rect
    front: Rect | None  # floor in front that must stay free


def _ends_a_row(spots: list[Spot], i: int) -> bool:
    """Return whether spot ``i`` is at the end of a row of adjacent spots, next to a corner or to another piece."""
    before, after = spots[i - 1] if i else None, spots[i + 1] if i + 1 < len(spots) else None
    return any(
        s is None or s.wall is not spots[i].wall or abs(s.centre - spots[i].centre) > 0.15 for s in (before, after)
    )


def overlap(a: Rect, b: Rect, gap: float = 0.0) -> bool:
    """Return whether two rectangles overlap or are closer than ``gap`` metres."""
    return a[0] < b[2] + gap and b[0] < a[2] + gap and a[1] < b[3] + gap and b[1] < a[3] + gap


def walls_of(layout: Layout, room: int) -> list[Wall]:
    """Return the four walls of a room, counter-clockwise from the wall at low y, with their doors and windows."""
    (x0, y0, _), (x1, y1, _) = layout.spaces[room].box
    corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
    walls = []
    for index in range(4):
        start, end = corners[index], corners[(index + 1) % 4]
        length = float(np.abs(end - start).sum())
        along = (end - start) / length
        inward = np.array([-along[1], along[0]])
        openings, windows = [], []
        for opening in layout.openings(room):
            lower, upper = opening.box
            centre = (lower[:2] + upper[:2]) / 2
            across = np.abs(np.array(opening.outward)) @ (centre - start)
            if abs(np.array(opening.outward) @ along) > 0.5 or abs(across) > 0.5:
                continue  # in another wall
            a, b = sorted((float((lower[:2] - start) @ along), float((upper[:2] - start) @ along)))
            if opening.kind == "door":
                openings.append((a, b))
            else:
                windows.append((a, b, float(lower[2])))
        doors = list(openings)
        if layout.entrance is not None and layout.entrance[:2] == (room, index):
            doors.append((layout.entrance[2] * UNIT, layout.entrance[2] * UNIT + 1.0))
        walls.append(Wall(index, start, along, inward, length, tuple(openings), tuple(doors), tuple(windows)))
    return walls


class RoomPlanner:
    """Hold the state of one room while furniture is placed."""

    def __init__(self, layout: Layout, room: int, rng: np.random.Generator) -> None:
        (x0, y0, _), (x1, y1, _) = layout.spaces[room].box
        self.room: Rect = (float(x0), float(y0), float(x1), float(y1))
        self.walls = walls_of(layout, room)
        self.rng = rng
        self.pieces: list[Piece] = []
        self.solid: list[Rect] = []  # floor occupied by furniture
        self.clear: list[Rect] = []  # floor that must stay free, in front of doors and cupboards
        for wall in self.walls:
            for a, b in wall.doors:
                self.clear.append(wall.rect(a - 0.1, b + 0.1, 0.0, DOOR_CLEARANCE))

    @property
    def area(self) -> float:
        """Return the floor area of the room in m^2."""
        return (self.room[2] - self.room[0]) * (self.room[3] - self.room[1])

    def piece(self, kind: str, x: float, y: float, yaw: float, size: Size, *, base: float = 0.0) -> Piece:
        """Make a piece with its own seed, without adding it to the room."""
        return Piece(kind, float(x), float(y), float(yaw), size, base, int(self.rng.integers(2**31)))

    def at_wall(
        self, wall: Wall, kind: str, centre: float, size: Size, *, base: float = 0.0, gap: float = GAP
    ) -> Piece:
        """Make a piece with its back at a wall and its middle at ``centre`` metres along it."""
        x, y = wall.point(centre, gap + size[1] / 2)
        return self.piece(kind, x, y, wall.yaw, size, base=base)

    def fits(self, rect: Rect, *, gap: float = GAP) -> bool:
        """Return whether a footprint is inside the room, ``gap`` metres from furniture, and off the clear floor."""
        inside = (
            rect[0] >= self.room[0] and rect[1] >= self.room[1] and rect[2] <= self.room[2] and rect[3] <= self.room[3]
        )
        return (
            inside
            and not any(overlap(rect, r, gap) for r in self.solid)
            and not any(overlap(rect, r) for r in self.clear)
        )

    def free_of_furniture(self, rect: Rect) -> bool:
        """Return whether a rectangle is suitable for a person: inside the room and free of furniture."""
        inside = (
            rect[0] >= self.room[0] and rect[1] >= self.room[1] and rect[2] <= self.room[2] and rect[3] <= self.room[3]
        )
        return inside and not any(overlap(rect, r) for r in self.solid)

    def add(self, pieces: Iterable[Piece], *, clear: Iterable[Rect] = (), solid: bool = True) -> None:
        """Add pieces to the room, and rectangles of floor that must stay clear.

        ``solid=False`` is for pieces that do not occupy the floor, such as rugs and lamps.
        """
        for piece in pieces:
            self.pieces.append(piece)
            if solid:
                (x0, y0, _), (x1, y1, _) = piece.box
                self.solid.append((float(x0), float(y0), float(x1), float(y1)))
        self.clear.extend(clear)

    def passable(self, extra: Iterable[Rect] = (), *, fronts: Iterable[Rect] = ()) -> bool:
        """Return whether all doors, clear floor and ``fronts`` remain connected by passages of at least 0.6 m.

        ``extra`` are footprints of additional furniture.
        """
        from scipy.ndimage import label

        targets = [*self.clear, *fronts]
        if len(targets) < 2:
            return True
        x = np.arange(self.room[0] + _GRID / 2, self.room[2], _GRID)
        y = np.arange(self.room[1] + _GRID / 2, self.room[3], _GRID)
        half = PASSAGE / 2
        free = np.ones((len(x), len(y)), dtype=bool)
        free[(x < self.room[0] + half - 0.05) | (x > self.room[2] - half + 0.05)] = False
        free[:, (y < self.room[1] + half - 0.05) | (y > self.room[3] - half + 0.05)] = False
        for r in [*self.solid, *extra]:
            free[np.ix_((x > r[0] - half) & (x < r[2] + half), (y > r[1] - half) & (y < r[3] + half))] = False
        labels, _ = label(free)
        common: set[int] | None = None
        reach = 0.15  # metres; a target counts as reached from this distance
        for r in targets:
            inside = labels[np.ix_((x > r[0] - reach) & (x < r[2] + reach), (y > r[1] - reach) & (y < r[3] + reach))]
            found = set(np.unique(inside)) - {0}
            common = found if common is None else common & found
        return bool(common)

    def wall_spots(self, size: Size, *, front: float, step: float = 0.1) -> list[Spot]:
        """Return positions at walls for a piece of this size with ``front`` metres of free floor in front.

        Pieces higher than a window sill are not placed in front of windows.
        """
        width, depth, height = size
        spots = []
        for wall in self.walls:
            for centre in np.arange(width / 2 + GAP, wall.length - width / 2 - GAP + 1e-9, step):
                a, b = float(centre - width / 2), float(centre + width / 2)
                if any(a < end + 0.05 and start - 0.05 < b and height > sill for start, end, sill in wall.windows):
                    continue
                if any(a < end + 0.1 and start - 0.1 < b for start, end in wall.doors):
                    continue
                footprint = wall.rect(a, b, GAP, GAP + depth)
                before = wall.rect(a, b, GAP + depth + 0.001, GAP + depth + front) if front else None
                if self.fits(footprint) and (before is None or self.free_of_furniture(before)):
                    spots.append(Spot(wall, float(centre), footprint, before))
        return spots

    def choose(self, spots: list[Spot], *, corner: bool = False) -> Spot | None:
        """Return a random spot that keeps the room passable; with ``corner``, at the end of a row of spots."""
        if corner:
            spots = [s for i, s in enumerate(spots) if _ends_a_row(spots, i)]
        for i in self.rng.permutation(len(spots)):
            spot = spots[i]
            if self.passable([spot.footprint], fronts=[spot.front] if spot.front else []):
                return spot
        return None

    def try_at_wall(self, kind: str, size: Size, *, front: float = 0.6, corner: bool = True) -> Piece | None:
        """Place a piece at a wall and return it, or None if it does not fit."""
        spot = self.choose(self.wall_spots(size, front=front), corner=corner)
        if spot is None:
            return None
        piece = self.at_wall(spot.wall, kind, spot.centre, size)
        self.add([piece], clear=[spot.front] if spot.front else [])
        return piece

    def roomiest(self, width: float, depth: float, *, margin: float) -> tuple[float, float] | None:
        """Return the centre of the free rectangle of this size that is farthest from walls and furniture.

        The result is None if it is closer than ``margin`` metres to a wall or furniture.
        """
        x = np.arange(self.room[0] + width / 2, self.room[2] - width / 2 + 1e-9, _GRID)[:, None]
        y = np.arange(self.room[1] + depth / 2, self.room[3] - depth / 2 + 1e-9, _GRID)[None, :]
        if not x.size or not y.size:
            return None
        rect = (x - width / 2, y - depth / 2, x + width / 2, y + depth / 2)
        distance = np.minimum(
            np.minimum(rect[0] - self.room[0], self.room[2] - rect[2]),
            np.minimum(rect[1] - self.room[1], self.room[3] - rect[3]),
        )
        for r in self.solid:
            distance = np.minimum(distance, _distance(rect, r))
        for r in self.clear:
            distance = np.where(_distance(rect, r) < 0, -np.inf, distance)
        # Distances are rounded, so that the first of equal ones is chosen and rounding errors do not matter.
        best = np.unravel_index(np.argmax(distance.round(6)), distance.shape)
        if distance[best] < margin - 1e-6:
            return None
        return float(x[best[0], 0]), float(y[0, best[1]])


def _distance(a: tuple[np.ndarray, ...], b: Rect) -> np.ndarray:
    """Return the distance in metres between each of many rectangles and one other; negative if they overlap.

    ``a`` are arrays of x0, y0, x1 and y1, one entry per rectangle.
    """
    return np.maximum(np.maximum(a[0] - b[2], b[0] - a[2]), np.maximum(a[1] - b[3], b[1] - a[3]))
