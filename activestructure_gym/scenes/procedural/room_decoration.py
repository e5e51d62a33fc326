"""Decorate rooms: curtains, radiators under windows, the lamp, pictures on free stretches of wall."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from activestructure_gym.scenes.procedural.furniture import Piece
from activestructure_gym.scenes.procedural.furniture_decor import PICTURES
from activestructure_gym.scenes.procedural.furniture_placement import RoomPlanner, Wall
from activestructure_gym.scenes.procedural.layout import CEILING, UNIT, WINDOW_HEAD


def hang_curtains(planner: RoomPlanner) -> None:
    """Place curtains left and right of every window, on a rod."""
    for wall in planner.walls:
        for a, b, _ in wall.windows:
            sides = [side for side in (a - 0.16, b + 0.16) if 0.17 < side < wall.length - 0.17]
            size = (0.32, 0.10, 2.26)
            planner.add([planner.at_wall(wall, "curtain", side, size, base=0.02, gap=0.03) for side in sides])
            start, end = max(a - 0.36, 0.03), min(b + 0.36, wall.length - 0.03)
            rod = planner.at_wall(
                wall, "curtain rod", (start + end) / 2, (end - start, 0.05, 0.035), base=2.285, gap=0.055
            )
            planner.add([rod], solid=False)


def add_radiators(planner: RoomPlanner) -> None:
    """Place a radiator under most windows with free space below."""
    for wall in planner.walls:
        for a, b, sill in wall.windows:
            width = min(b - a, 1.2)
            below = wall.rect((a + b - width) / 2, (a + b + width) / 2, 0.0, 0.10)
            if sill < 1.0 and planner.rng.random() < 0.7 and planner.free_of_furniture(below):
                planner.add([planner.at_wall(wall, "radiator", (a + b) / 2, (width, 0.10, 0.75), gap=0.0)])


def hang_lamp(planner: RoomPlanner) -> None:
    """Place a lamp over the dining table or in the middle of the room, its rim 2.05 m above the floor."""
    tables = [piece for piece in planner.pieces if piece.kind == "dining table"]
    x, y = (planner.room[0] + planner.room[2]) / 2, (planner.room[1] + planner.room[3]) / 2
    if tables and planner.area < 18:
        x, y = tables[0].x, tables[0].y
    width = float(planner.rng.uniform(0.36, 0.5))
    height = CEILING * UNIT - 2.05
    planner.add([planner.piece("pendant", x, y, 0.0, (width, width, height), base=2.05)], solid=False)


def hang_pictures(planner: RoomPlanner, *, most: int) -> None:
    """Place up to ``most`` pictures on free stretches of wall, their middle at 1.62 m, over low furniture first."""
    rng = planner.rng
    low = [p for p in planner.pieces if p.kind in ("sofa", "bed", "dresser", "nightstand", "coffee table", "armchair")]
    motifs = rng.permutation(PICTURES)
    hung = 0
    for wall in [planner.walls[i] for i in rng.permutation(4)]:
        for _ in range(2):
            width, height = rng.uniform(0.5, 0.95), rng.uniform(0.45, 0.7)
            over = [float((np.array([p.x, p.y]) - wall.start) @ wall.along) for p in low if _near(wall, p)]
            tries = [*over, *rng.uniform(0.4, max(0.5, wall.length - 0.4), 6)]
            for centre in tries:
                if hung < most and _free_on_wall(planner, wall, centre, width):
                    size = (float(width), 0.03, float(height))
                    base = 1.62 - float(height) / 2
                    piece = planner.at_wall(wall, "picture", float(centre), size, base=base, gap=0.0)
                    planner.add([replace(piece, seed=int(motifs[hung]))], solid=False)
                    hung += 1
                    break


def _near(wall: Wall, piece: Piece) -> bool:
    away = (np.array([piece.x, piece.y]) - wall.start) @ wall.inward
    return bool(away < 1.3)


def _free_on_wall(planner: RoomPlanner, wall: Wall, centre: float, width: float) -> bool:
    a, b = centre - width / 2 - 0.12, centre + width / 2 + 0.12
    if a < 0.1 or b > wall.length - 0.1:
        return False
    if any(a < end and start < b for start, end in wall.doors):
        return False
    if any(a < end + 0.35 and start - 0.35 < b for start, end, _ in wall.windows):
        return False
    strip = wall.rect(a, b, 0.0, 0.7)
    for piece in planner.pieces:
        lower, upper = piece.box
        if upper[2] < 1.2 or lower[2] > WINDOW_HEAD * UNIT or piece.kind == "pendant":
            continue
        if lower[0] < strip[2] and upper[0] > strip[0] and lower[1] < strip[3] and upper[1] > strip[1]:
            return False
    return True
