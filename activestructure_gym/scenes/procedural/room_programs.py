"""Furnish rooms by kind: each kind has a fixed order in which its furniture is placed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from activestructure_gym.scenes.procedural.furniture import Piece
from activestructure_gym.scenes.procedural.furniture_fixtures import MODULE
from activestructure_gym.scenes.procedural.furniture_placement import GAP, RoomPlanner, Wall
from activestructure_gym.scenes.procedural.room_decoration import add_radiators, hang_curtains, hang_lamp, hang_pictures

# Metres, thickness of a rug. Light samples are farther above the floor (baked_light), so a rug casts no shadow.
RUG = 0.006


def furnish_room(planner: RoomPlanner, kind: str) -> list[Piece]:
    """Furnish a room of the given kind, with curtains, radiators, a lamp and pictures; return all pieces."""
    if kind not in ("bath", "kitchen"):
        hang_curtains(planner)
    _PROGRAMS[kind](planner)
    add_radiators(planner)
    hang_lamp(planner)
    if kind != "bath":
        hang_pictures(planner, most=2 if kind == "kitchen" else 4)
    return planner.pieces


def _living(planner: RoomPlanner) -> None:
    _media_corner(planner)
    if planner.area > 17.0:
        _dining_group(planner, seats=4)
    planner.try_at_wall("shelf", (float(planner.rng.choice([0.8, 0.9])), 0.3, 1.9), front=0.5)
    planner.try_at_wall("floor lamp", (0.42, 0.42, 1.6), front=0.0)
    planner.try_at_wall("plant", (0.7, 0.7, 1.3), front=0.0)
    planner.try_at_wall("armchair", (0.85, 0.82, 0.82), front=0.4)
    planner.try_at_wall("dresser", (1.0, 0.42, 0.82), front=0.5)
    planner.try_at_wall("shelf", (0.8, 0.3, 0.95), front=0.5)


def _media_corner(planner: RoomPlanner) -> None:
    """Place television and sofa face to face, with a rug and a coffee table between; else both at any wall."""
    rng = planner.rng
    sofa = (float(rng.choice([2.1, 2.1, 1.8])), 0.92, 0.84)
    bench = (1.6, 0.40, 1.22)
    found = None
    spots = planner.wall_spots(bench, front=2.2)
    for i in rng.permutation(len(spots)):
        wall, centre = spots[i].wall, spots[i].centre
        depth = planner.room[3] - planner.room[1] if wall.index in (0, 2) else planner.room[2] - planner.room[0]
        # The sofa is at the opposite wall if the room is less than 4.6 m deep, else free-standing with a passage
        # behind.
        back = depth - GAP if depth < 4.6 else min(3.9, depth - 1.0)
        rect = wall.rect(centre - sofa[0] / 2, centre + sofa[0] / 2, back - sofa[1], back)
        if planner.fits(rect) and planner.passable([rect, spots[i].footprint]):
            found = wall, centre, back
            break
    if found is None:
        planner.try_at_wall("media bench", bench, front=1.2)
        planner.try_at_wall("sofa", (1.8, 0.9, 0.84), front=0.6)
        return
    wall, centre, back = found
    x, y = wall.point(centre, back - sofa[1] / 2)
    planner.add([planner.at_wall(wall, "media bench", centre, bench)])
    planner.add([planner.piece("sofa", x, y, wall.yaw + np.pi, sofa)])
    table = (1.05, 0.55, 0.42)
    away = back - sofa[1] - 0.38 - table[1] / 2
    x, y = wall.point(centre, away)
    if planner.fits(wall.rect(centre - table[0] / 2, centre + table[0] / 2, away - table[1] / 2, away + table[1] / 2)):
        planner.add([planner.piece("coffee table", x, y, wall.yaw, table)])
    x, y = wall.point(centre, away + 0.1)
    room = [planner.room[2] - planner.room[0], planner.room[3] - planner.room[1]][wall.index % 2]
    wide = min(2.3, room - 0.5)
    near, far = max(0.5, away - 0.75), back - sofa[1] + 0.25
    x, y = wall.point(float(np.clip(centre, wide / 2 + 0.2, wall.length - wide / 2 - 0.2)), (near + far) / 2)
    planner.add([planner.piece("rug", x, y, wall.yaw, (wide, far - near, RUG))], solid=False)
    # Keep the space between television and table free.
    planner.clear.append(wall.rect(centre - 0.8, centre + 0.8, GAP + bench[1] + 0.01, away - table[1] / 2 - 0.05))


def _dining_group(planner: RoomPlanner, *, seats: int) -> None:
    """Place a table with ``seats`` chairs (2 or 4) at the most open position, else with one side at a wall."""
    rng = planner.rng
    sizes = [(1.4, 0.8), (1.2, 0.75)] if seats > 2 else [(0.8, 0.75), (0.75, 0.7)]
    # Try positions with space to walk around the table first, then positions with the chairs of one side at a wall.
    for margin, (width, depth) in [(margin, size) for margin in (0.24, 0.0) for size in sizes]:
        for turned in rng.permutation([0, 1]):
            # The footprint includes chairs, which extend up to 0.32 m on both long sides.
            outer = (width + 0.05, depth + 0.64)
            group = outer[::-1] if turned else outer
            middle = planner.roomiest(*group, margin=margin)
            if middle is None:
                continue
            rect = (
                middle[0] - group[0] / 2,
                middle[1] - group[1] / 2,
                middle[0] + group[0] / 2,
                middle[1] + group[1] / 2,
            )
            if not planner.passable([rect]):
                continue
            yaw = float(turned * np.pi / 2)
            pieces = [planner.piece("dining table", *middle, yaw, (width, depth, 0.75))]
            places = (-width / 4, width / 4) if seats > 2 else (0.0,)
            for place in places:
                for sign in (-1, 1):
                    local = np.array(
                        [place + rng.uniform(-0.03, 0.03), sign * (depth / 2 + 0.04 + rng.uniform(-0.02, 0.02))]
                    )
                    cos, sin = np.cos(yaw), np.sin(yaw)
                    x, y = middle[0] + cos * local[0] - sin * local[1], middle[1] + sin * local[0] + cos * local[1]
                    facing = yaw + (0 if sign < 0 else np.pi) + rng.uniform(-0.12, 0.12)
                    pieces.append(planner.piece("chair", x, y, facing, (0.43, 0.44, 0.9)))
            planner.add(pieces)
            return


def _bed_group(planner: RoomPlanner, *, double: bool) -> None:
    """Place the bed with its headboard at a wall, and a nightstand on each side with enough space."""
    stand = (0.45, 0.40, 0.90)
    widths = [1.6, 1.4] if double else [1.0, 0.9]
    for width in widths:
        for stands in (2, 1) if double else (1,):
            whole = width + stands * (stand[0] + 0.06)
            spots = planner.wall_spots((whole, 2.1, 1.05), front=0.35)
            if double and stands == 2:
                spots = [s for s in spots if abs(s.centre - s.wall.length / 2) < 0.45] or spots
            spot = planner.choose(spots, corner=not double)
            if spot is None:
                continue
            wall, centre = spot.wall, spot.centre
            bed = centre if stands == 2 else centre - (stand[0] + 0.06) / 2
            pieces = [planner.at_wall(wall, "bed", bed, (width, 2.08, 1.02))]
            for side in (1, -1)[:stands]:
                pieces.append(
                    planner.at_wall(wall, "nightstand", bed + side * (width / 2 + 0.05 + stand[0] / 2), stand)
                )
            planner.add(pieces, clear=[wall.rect(bed - width / 2, bed + width / 2, 2.13, 2.6)])
            x, y = wall.point(bed, 1.75)
            if double:
                planner.add([planner.piece("rug", x, y, wall.yaw, (width + 0.9, 1.3, RUG))], solid=False)
            return


def _bedroom(planner: RoomPlanner) -> None:
    _bed_group(planner, double=True)
    for width in (2.0, 1.5, 1.0):
        if planner.try_at_wall("wardrobe", (width, 0.6, 2.15), front=0.6):
            break
    planner.try_at_wall("dresser", (1.0, 0.42, 0.82), front=0.5)
    planner.try_at_wall("armchair", (0.85, 0.82, 0.82), front=0.4)
    planner.try_at_wall("plant", (0.6, 0.6, 1.1), front=0.0)
    planner.try_at_wall("floor lamp", (0.42, 0.42, 1.55), front=0.0)


def _child(planner: RoomPlanner) -> None:
    _bed_group(planner, double=False)
    _desk_group(planner)
    planner.try_at_wall("wardrobe", (1.0, 0.55, 1.95), front=0.6)
    planner.try_at_wall("shelf", (0.9, 0.3, 0.95), front=0.5)
    spot = planner.roomiest(1.5, 1.2, margin=0.0)
    if spot:
        planner.add([planner.piece("rug", *spot, 0.0, (1.5, 1.2, RUG))], solid=False)
    planner.try_at_wall("pouf", (0.5, 0.5, 0.42), front=0.0)


def _desk_group(planner: RoomPlanner) -> None:
    """Place a desk with a swivel chair half under it."""
    size = (1.4, 0.68, 1.16) if planner.area > 9 else (1.2, 0.65, 1.16)
    spots = planner.wall_spots((size[0], size[1], 0.75), front=0.85)
    # The chair, at any rotation, must not block a doorway.
    seats = [s.wall.rect(s.centre - 0.2, s.centre + 0.6, size[1], size[1] + 0.62) for s in spots]
    spot = planner.choose([s for s, seat in zip(spots, seats) if planner.fits(seat, gap=0.0)])
    if spot is None:
        return
    wall, centre = spot.wall, spot.centre
    x, y = wall.point(centre + 0.2, size[1] + 0.24)
    desk = planner.at_wall(wall, "desk", centre, size)
    seat = planner.piece("office chair", x, y, wall.yaw + np.pi + planner.rng.uniform(-0.5, 0.5), (0.6, 0.6, 0.95))
    planner.add([desk, seat], clear=[wall.rect(centre - 0.3, centre + 0.6, size[1] + 0.6, size[1] + 1.1)])


def _study(planner: RoomPlanner) -> None:
    _desk_group(planner)
    for _ in range(2):
        planner.try_at_wall("shelf", (0.9, 0.3, 1.9), front=0.6)
    planner.try_at_wall("armchair", (0.85, 0.82, 0.82), front=0.5)
    planner.try_at_wall("floor lamp", (0.42, 0.42, 1.55), front=0.0)
    planner.try_at_wall("plant", (0.6, 0.6, 1.2), front=0.0)
    spot = planner.roomiest(1.8, 1.3, margin=0.0)
    if spot:
        planner.add([planner.piece("rug", *spot, 0.0, (1.8, 1.3, RUG))], solid=False)
    planner.try_at_wall("dresser", (1.0, 0.42, 0.82), front=0.5)


def _kitchen(planner: RoomPlanner) -> None:
    _kitchen_line(planner)
    _dining_group(planner, seats=4 if planner.area > 9.5 else 2)
    planner.try_at_wall("dresser", (1.0, 0.42, 0.82), front=0.5)
    planner.try_at_wall("plant", (0.5, 0.5, 1.0), front=0.0)


def _kitchen_line(planner: RoomPlanner) -> None:
    """Place fridge and base units in one line at a wall, with tiles and cupboards above where there is no window."""
    tall = 0.66
    for units, free in ((5, 0.8), (4, 0.8), (3, 0.8), (3, 0.6), (2, 0.6)):  # free: metres in front of the units
        width = units * MODULE
        found = None
        spots = planner.wall_spots((width + tall, 0.66, 0.89), front=free)
        at_corner = [s for s in spots if min(s.centre, s.wall.length - s.centre) < (width + tall) / 2 + 0.15]
        for spot in [group[i] for group in (at_corner, spots) for i in planner.rng.permutation(len(group))]:
            for sign in (-1, 1):
                fridge = spot.centre + sign * width / 2
                lit = any(fridge - 0.36 < b and a < fridge + 0.36 for a, b, _ in spot.wall.windows)
                if found is None and not lit and planner.passable([spot.footprint]):
                    found = spot.wall, spot.centre, sign
        if found is None:
            continue
        wall, centre, sign = found
        run, cold = centre - sign * tall / 2, centre + sign * width / 2
        front = wall.rect(centre - (width + tall) / 2, centre + (width + tall) / 2, 0.72, 0.72 + free - 0.2)
        planner.add(
            [
                planner.at_wall(wall, "kitchen run", run, (width, 0.6, 0.9), gap=0.0),
                planner.at_wall(wall, "fridge", cold, (0.62, 0.65, 1.85)),
            ],
            clear=[front],
        )
        _kitchen_wall(planner, wall, run - width / 2, run + width / 2)
        return


def _kitchen_wall(planner: RoomPlanner, wall: Wall, start: float, end: float) -> None:
    """Place tiles and cupboards over the worktop from ``start`` to ``end`` (metres along the wall) between windows."""
    edges = [(start, end)]
    for a, b, _ in wall.windows:
        edges = [
            piece for left, right in edges for piece in ((left, min(right, a - 0.08)), (max(left, b + 0.08), right))
        ]
        edges = [(left, right) for left, right in edges if right - left > 0.1]
    for left, right in edges:
        size = (right - left, 0.012, 0.55)
        planner.add([planner.at_wall(wall, "splashback", (left + right) / 2, size, base=0.9, gap=0.0)], solid=False)
        count = int((right - left + 1e-6) / MODULE)
        if count:
            centre = left + count * MODULE / 2 if left == start else right - count * MODULE / 2
            size = (count * MODULE, 0.35, 0.7)
            planner.add([planner.at_wall(wall, "wall units", centre, size, base=1.45, gap=0.0)], solid=False)


def _bath(planner: RoomPlanner) -> None:
    if not planner.try_at_wall("bathtub", (1.6, 0.72, 0.58), front=0.5):
        planner.try_at_wall("bathtub", (1.4, 0.7, 0.58), front=0.4)
    planner.try_at_wall("vanity", (0.8, 0.46, 1.86), front=0.5, corner=False)
    planner.try_at_wall("toilet", (0.40, 0.66, 0.80), front=0.45, corner=False)
    planner.try_at_wall("washing machine", (0.6, 0.6, 0.85), front=0.5)
    spot = planner.roomiest(0.8, 0.5, margin=0.0)
    if spot:
        planner.add([planner.piece("mat", *spot, 0.0, (0.8, 0.5, RUG))], solid=False)
    chosen = planner.choose(planner.wall_spots((0.5, 0.11, 1.75), front=0.0))
    if chosen:
        rail = planner.at_wall(chosen.wall, "towel rail", chosen.centre, (0.5, 0.11, 1.05), base=0.7, gap=0.0)
        planner.add([rail])


def _dining(planner: RoomPlanner) -> None:
    _dining_group(planner, seats=4)
    planner.try_at_wall("dresser", (1.2, 0.42, 0.82), front=0.5)
    planner.try_at_wall("shelf", (0.9, 0.3, 1.9), front=0.5)
    planner.try_at_wall("plant", (0.7, 0.7, 1.4), front=0.0)
    planner.try_at_wall("floor lamp", (0.42, 0.42, 1.55), front=0.0)


_PROGRAMS: dict[str, Callable[[RoomPlanner], None]] = {
    "bath": _bath,
    "bedroom": _bedroom,
    "child": _child,
    "dining": _dining,
    "kitchen": _kitchen,
    "living": _living,
    "study": _study,
}
