"""Add trim to the walls of every room: skirting boards, door casings, window frames and sills, front door."""

from __future__ import annotations

import numpy as np

from activestructure_gym.scenes.procedural.furniture import Piece
from activestructure_gym.scenes.procedural.furniture_placement import Wall, walls_of
from activestructure_gym.scenes.procedural.layout import DOOR_HEAD, NICHE, UNIT, WINDOW_HEAD, Layout
from activestructure_gym.scenes.procedural.materials import Materials
from activestructure_gym.scenes.procedural.mesh_builder import MeshBuilder
from activestructure_gym.scenes.procedural.mesh_shapes import box

_SKIRTING = (0.08, 0.015)  # metres: height, thickness
_CASING = (0.07, 0.02)  # metres: width of the frame around a door, thickness
_SILL = (0.03, 0.04)  # metres: thickness of a window board, its depth into the room


def window_frames(layout: Layout) -> list[Piece]:
    """Return one frame per window, directly in front of its pane."""
    pieces = []
    for room in range(layout.rooms):
        for wall in walls_of(layout, room):
            for a, b, sill in wall.windows:
                depth, height = 0.06, WINDOW_HEAD * UNIT - sill
                x, y = wall.point((a + b) / 2, depth / 2 + 0.002 - NICHE * UNIT)
                size = (b - a, depth, height)
                pieces.append(Piece("window frame", float(x), float(y), wall.yaw, size, base=sill))
    return pieces


def front_door(layout: Layout) -> list[Piece]:
    """Return the closed entrance door on the inner face of an outer wall, or [] if the plan has none."""
    if layout.entrance is None:
        return []
    room, index, step = layout.entrance
    wall = walls_of(layout, room)[index]
    x, y = wall.point(step * UNIT + 0.5, 0.03)
    return [Piece("front door", float(x), float(y), wall.yaw, (1.0, 0.06, 2.08))]


def add_trim(builder: MeshBuilder, materials: Materials, layout: Layout) -> None:
    """Add skirting boards, door casings and window boards of all rooms to the mesh, as structural parts."""
    for room in range(layout.rooms):
        kind = layout.spaces[room].kind
        for wall in walls_of(layout, room):
            origin = (float(wall.start[0]), float(wall.start[1]), 0.0)
            with builder.placed(origin, wall.yaw):
                if kind != "bath":  # tiled to the floor
                    builder.part(f"{kind} {room} skirting {wall.index}", structural=True)
                    _skirting(builder, materials, wall)
                builder.part(f"{kind} {room} casing {wall.index}", structural=True)
                _casings(builder, materials, wall)


def _skirting(builder: MeshBuilder, materials: Materials, wall: Wall) -> None:
    height, thick = _SKIRTING
    edges = [0.0]
    for a, b in sorted(wall.doors):
        edges += [a - _CASING[0], b + _CASING[0]]
    edges.append(wall.length)
    for a, b in zip(edges[::2], edges[1::2]):
        if b - a > 0.02:
            builder.add(box(np.array([a, 0.0, 0.0]), np.array([b, thick, height])), materials["trim"])


def _casings(builder: MeshBuilder, materials: Materials, wall: Wall) -> None:
    wide, thick = _CASING
    head = DOOR_HEAD * UNIT
    trim = materials["trim"]
    for a, b in wall.openings:
        builder.add(box(np.array([a - wide, 0.0, 0.0]), np.array([a, thick, head])), trim)
        builder.add(box(np.array([b, 0.0, 0.0]), np.array([b + wide, thick, head])), trim)
        builder.add(box(np.array([a - wide, 0.0, head]), np.array([b + wide, thick, head + wide])), trim)
    thick, out = _SILL
    for a, b, sill in wall.windows:
        builder.add(box(np.array([a, 0.001 - NICHE * UNIT, sill]), np.array([b, 0.0, sill + thick])), trim)
        builder.add(box(np.array([a - 0.04, 0.0, sill]), np.array([b + 0.04, out, sill + thick])), trim)
