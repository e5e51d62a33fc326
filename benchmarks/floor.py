"""Build a scene of a whole floor: apartments of seven rooms on both sides of a corridor.

    asg compare --scenes "benchmarks.floor:make_floor" --policies hole_area

Twelve apartments take 25 x 57 m. Every apartment is a layout of `plan_layout` that has a doorway, and no windows, in
the wall to the corridor. A lattice step is 0.1 m.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.scenes.procedural.apartment import build_apartment
from activestructure_gym.scenes.procedural.apartment_plan import ApartmentPlan, furnish
from activestructure_gym.scenes.procedural.layout import CEILING, DOOR_HEAD, NICHE, UNIT, Layout, Space, plan_layout
from activestructure_gym.scenes.scene import Scene, SceneMesh

_ROOMS = 7  # rooms per apartment
_WIDTH = 24  # width of the corridor in lattice steps
_DOOR, _BESIDE = 9, 2  # width of a doorway, and of the wall next to it, in lattice steps
_APART = 1  # lattice steps between neighbouring apartments

Side = Literal[-1, 1]  # side of an apartment on which the corridor is: low (-1) or high (1) x


def make_floor(*, seed: int = 0, apartments: int = 12, lit: bool = True) -> Scene:
    """Build a floor of furnished apartments, half of them on each side of a corridor.

    ``apartments`` is their number, at least 2. Without ``lit``, the floor has no light and no textures.
    """
    if isinstance(apartments, bool) or not isinstance(apartments, int) or apartments < 2:
        raise InputError(f"a floor has at least two apartments, got apartments={apartments!r}")
    parts: list[SceneMesh] = []
    doors: list[np.ndarray] = []  # [2, 3] metres
    layouts: list[tuple[Side, Layout, Space]] = []
    for number in range(apartments):
        side: Side = -1 if number % 2 else 1
        layouts.append((side, *with_doorway(_layout(seed + number), side)))
    left = max(layout.owner.shape[0] for side, layout, _ in layouts if side == 1)  # lower x of the corridor
    reached = {-1: 0, 1: 0}
    for number, (side, layout, door) in enumerate(layouts):
        start = left - door.upper[0] if side == 1 else left + _WIDTH - door.lower[0]
        shift = np.array([start, reached[side], 0]) * UNIT
        reached[side] += layout.owner.shape[1] + _APART
        own = seed + number
        built = build_apartment(furnish(layout, seed=own), name="apartment", source="floor", seed=own, lit=lit)
        plane = door.box[1 if side == 1 else 0, 0]
        parts.append(_moved(_without(built.mesh, plane, [door.box]), shift))
        doors.append(door.box + shift)
    corridor = _corridor(max(reached.values()), seed, lit)
    shift = np.array([left - NICHE, -NICHE, 0]) * UNIT
    mesh = _moved(corridor.mesh, shift)
    for plane in (left * UNIT, (left + _WIDTH) * UNIT):
        mesh = _without(mesh, plane, doors)
    source = f"make_floor(seed={seed}, apartments={apartments}" + ("" if lit else ", lit=False") + ")"
    return Scene(name=f"floor-{apartments}-{seed}", mesh=_joined([*parts, mesh]), source=source)


def with_doorway(layout: Layout, side: Side) -> tuple[Layout, Space]:
    """Put a doorway into the outer wall on a ``side``, low (-1) or high (1) x, and remove the windows of this wall.

    Return the new layout, and the doorway.
    """
    rooms = layout.spaces[: layout.rooms]
    edge = max(room.upper[0] for room in rooms) if side == 1 else min(room.lower[0] for room in rooms)
    outer = [i for i, room in enumerate(rooms) if (room.upper[0] if side == 1 else room.lower[0]) == edge]
    room = max(outer, key=lambda i: (rooms[i].kind == "living", rooms[i].upper[1] - rooms[i].lower[1]))
    start = rooms[room].lower[1] + _BESIDE
    low, high = (edge, edge + NICHE) if side == 1 else (edge - NICHE, edge)
    door = Space("door", (low, start, 0), (high, start + _DOOR, DOOR_HEAD), room, (side, 0))
    kept = [space for space in layout.spaces if not (space.kind == "window" and space.outward == (side, 0))]
    return replace(layout, spaces=(*kept, door), entrance=None), door


def _layout(seed: int) -> Layout:
    return plan_layout(np.random.default_rng([seed, _ROOMS]), rooms=_ROOMS, seed=seed)


def _corridor(length: int, seed: int, lit: bool) -> Scene:
    """Build a tiled corridor of ``length`` lattice steps from pieces of about 8 m, each of which has a lamp."""
    ends = np.linspace(NICHE, NICHE + length, 1 + max(1, round(length / 80))).astype(int).tolist()
    pieces = [
        Space("bath", (NICHE, a, 0), (NICHE + _WIDTH, b, CEILING), i) for i, (a, b) in enumerate(zip(ends, ends[1:]))
    ]
    plan = ApartmentPlan(Layout(tuple(pieces), len(pieces)), ())
    return build_apartment(plan, name="corridor", source="floor", seed=seed, lit=lit)


def _without(mesh: SceneMesh, plane: float, boxes: Sequence[np.ndarray]) -> SceneMesh:
    """Remove the triangles that are in the plane x = ``plane`` (metres) and inside one of the boxes.

    A box [2, 3] has its lower and its upper corner in metres.
    """
    corners = mesh.vertices[mesh.faces].astype(np.float64)  # [F, 3, 3]
    near = 1e-3  # metres; vertices are float32 points of a lattice of 0.1 m
    gone = np.zeros(len(corners), dtype=bool)
    for box in boxes:
        gone |= ((corners >= box[0] - near) & (corners <= box[1] + near)).all(axis=(1, 2))
    gone &= (np.abs(corners[:, :, 0] - plane) < near).all(axis=1)
    return replace(mesh, faces=mesh.faces[~gone], face_texture=mesh.face_texture[~gone])


def _moved(mesh: SceneMesh, shift: np.ndarray) -> SceneMesh:
    return replace(mesh, vertices=(mesh.vertices + shift).astype(np.float32))


def _joined(parts: Sequence[SceneMesh]) -> SceneMesh:
    vertices = np.cumsum([0, *(len(part.vertices) for part in parts)])
    textures = np.cumsum([0, *(len(part.textures) for part in parts)])
    return SceneMesh(
        vertices=np.concatenate([part.vertices for part in parts]),
        faces=np.concatenate([part.faces + np.int32(first) for part, first in zip(parts, vertices)]),
        colors=np.concatenate([part.colors for part in parts]),
        uv=np.concatenate([part.uv for part in parts]),
        face_texture=np.concatenate([
            np.where(part.face_texture < 0, -1, part.face_texture + first).astype(np.int32)
            for part, first in zip(parts, textures)
        ]),
        textures=tuple(texture for part in parts for texture in part.textures),
    )  # fmt: skip
