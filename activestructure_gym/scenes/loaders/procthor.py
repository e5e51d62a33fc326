"""Load houses of ProcTHOR and AI2-THOR from JSON, with boxes instead of furniture assets.

Included are walls with doorways and windows, floors and ceilings. A file is one house (``house.json``) or one per line
(``train.jsonl``, also gzipped). Positions are metres with y up in a left-handed frame; swapping y and z gives this
project's frame. The house holds the asset, centre and rotation of an object; `procthor_sizes` holds the asset's
bounding box. Doors between rooms are open, outer doors closed; window panes and outer doors close the house. Source of
the layout: [procthor].
"""

from __future__ import annotations

import colorsys
import gzip
import io
import json
import os
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from activestructure_gym.errors import InputError, short_repr
from activestructure_gym.scenes.loaders.budget import SceneBudget
from activestructure_gym.scenes.loaders.damage import UnreadableMesh
from activestructure_gym.scenes.loaders.mesh_loader import finished_scene
from activestructure_gym.scenes.loaders.mesh_parts import MeshPart, assemble
from activestructure_gym.scenes.loaders.polygons import triangulated
from activestructure_gym.scenes.loaders.procthor_sizes import asset_size
from activestructure_gym.scenes.scene import Scene

SUFFIXES = (".json", ".jsonl", ".json.gz", ".jsonl.gz")
_MAX_OBJECTS, _MAX_WALLS = 5000, 5000
_MAX_HOUSE_BYTES = 64 << 20  # maximum size of one house, bytes

_USUAL, _SMALL = 0.4, 0.15  # metres, edge of an unknown object on the floor, and on another object (own choice)


def load_procthor_scene(path: str | os.PathLike[str], *, house: int = 0, objects: bool = True) -> Scene:
    """Load a house of ProcTHOR.

    Parameters
    ----------
    path
        A house as JSON, or a file with one per line, ``.jsonl`` or ``.jsonl.gz``.
    house
        Index of the house in the file, from 0.
    objects
        Whether to add boxes for the furniture.

    Raises
    ------
    InputError
        If the file or the house in it is missing or invalid.
    """
    path = Path(os.path.expanduser(path))
    if not path.is_file():
        raise InputError(f"there is no ProcTHOR file '{path}'")
    if not path.name.lower().endswith(SUFFIXES):
        raise InputError(f"a ProcTHOR house is a file {', '.join(SUFFIXES)}, got '{path.name}'")
    try:
        parts, doubts = _parts(json.loads(_text(path, house)), objects=objects)
    except KeyError as error:
        raise InputError(f"'{path}' is not a ProcTHOR house: {error} is missing") from None
    except (TypeError, AttributeError, IndexError):
        raise InputError(f"'{path}' is not a ProcTHOR house: a part of it is of another kind") from None
    except RecursionError:
        raise InputError(f"'{path}' is not a ProcTHOR house: it is nested too deeply") from None
    except (UnreadableMesh, ValueError, OverflowError, OSError, EOFError, zlib.error) as error:
        raise InputError(f"'{path}' is not a ProcTHOR house: {' '.join(str(error).split())[:200]}") from None
    stem = path.name.partition(".")[0]
    name = f"{stem}-{house}" if ".jsonl" in path.name.lower() else stem
    return finished_scene(assemble(parts, ()), path, name=name, doubts=doubts)


def _text(path: Path, house: int) -> bytes:
    """Return the JSON text of house number ``house`` in a file, as bytes."""
    if house < 0:
        raise UnreadableMesh(f"houses are counted from 0 on, got {house}")
    data = SceneBudget().read(path)
    name, file = path.name.lower(), io.BytesIO(data)
    if name.endswith(".gz"):
        return _house(gzip.GzipFile(fileobj=file), house, many=".jsonl" in name)
    return _house(file, house, many=".jsonl" in name)


def _house(file: io.BufferedIOBase, house: int, *, many: bool) -> bytes:
    if not many:
        if house:
            raise UnreadableMesh(f"it holds one house, and number {house} was asked for")
        return _limited(file.read(_MAX_HOUSE_BYTES + 1))
    number = 0
    while line := _limited(file.readline(_MAX_HOUSE_BYTES + 1)):
        if line.strip():
            if number == house:
                return line
            number += 1
    raise UnreadableMesh(f"it holds {number} houses, and number {house} was asked for")


def _limited(data: bytes) -> bytes:
    if len(data) > _MAX_HOUSE_BYTES:
        raise UnreadableMesh(f"a house has more than {_MAX_HOUSE_BYTES:,} bytes")
    return data


def _parts(house: dict[str, Any], *, objects: bool) -> tuple[list[MeshPart], list[str]]:
    """Return the parts of a house, and doubts about them for the user."""
    all_walls = [_Wall(wall) for wall in _list(house["walls"], "walls", _MAX_WALLS)]
    walls = {wall.id: wall for wall in all_walls}
    rooms = {str(room["id"]) for room in house["rooms"]}
    panes: list[MeshPart] = []
    for kind in ("doors", "windows"):
        for hole in _list(house.get(kind, []), kind, _MAX_WALLS):
            panes += _cut(hole, walls, rooms, door=kind == "doors")
    parts = [wall.part() for wall in all_walls if not wall.empty]
    top = max((wall.top for wall in all_walls), default=2.5)
    for room in house["rooms"]:
        floor = _points(room["floorPolygon"])
        tint = _tint(str(room.get("floorMaterial", "")), str(room["id"]))
        parts += [_polygon(floor, tint), _polygon(floor + [0.0, 0.0, top - floor[:, 2].min()], (0.93, 0.93, 0.91))]
    parts += panes
    doubtful: list[str] = []
    for thing in _list(house.get("objects", []), "objects", _MAX_OBJECTS) if objects else ():
        parts += _boxes(thing, doubtful, on_floor=True)
    if not doubtful:
        return parts, []
    some = ", ".join(map(short_repr, dict.fromkeys(doubtful[:5])))
    return parts, [f"{len(doubtful)} objects are no asset of ProcTHOR's database, so their size is estimated: {some}"]


class _Wall:
    """Represent a wall as an upright rectangle with rectangular holes."""

    def __init__(self, wall: dict[str, Any]) -> None:
        self.id = str(wall["id"])
        corners = _points(wall["polygon"])
        lowest = corners[np.argsort(corners[:, 2], kind="stable")[:2]]
        self.start, self.top = lowest[0], float(corners[:, 2].max())
        along = lowest[1] - lowest[0]
        self.width, self.height = float(np.linalg.norm(along[:2])), self.top - float(self.start[2])
        if self.width < 1e-6 or self.height < 1e-6:
            raise UnreadableMesh(f"the wall {short_repr(wall['id'])} has no width or no height")
        self.along = np.array([along[0], along[1], 0.0]) / self.width
        self.tint = _tint(_material(wall.get("material")), "wall")
        self.empty = bool(wall.get("empty"))  # True for a boundary inside one space, where there is no wall
        self.holes: list[tuple[float, float, float, float]] = []  # left, right, bottom, top in metres

    def at(self, x: float, y: float) -> np.ndarray:  # metres along and up -> [3]
        place: np.ndarray = self.start + x * self.along + [0.0, 0.0, y]
        return place

    def part(self) -> MeshPart:
        """Return the triangles of the wall without its holes.

        The front of a wall faces its room, that of an outer wall faces outward. Between two rooms are two walls in one
        plane.
        """
        xs = sorted({0.0, self.width, *(x for hole in self.holes for x in hole[:2])})
        ys = sorted({0.0, self.height, *(y for hole in self.holes for y in hole[2:])})
        quads = [
            [self.at(a, low), self.at(b, low), self.at(b, high), self.at(a, high)]
            for a, b in zip(xs, xs[1:])
            for low, high in zip(ys, ys[1:])
            if not any(
                left <= 0.5 * (a + b) <= right and bottom <= 0.5 * (low + high) <= top
                for left, right, bottom, top in self.holes
            )
        ]
        return _quads(np.array(quads).reshape(-1, 4, 3), self.tint)


def _cut(hole: dict[str, Any], walls: dict[str, _Wall], rooms: set[str], *, door: bool) -> list[MeshPart]:
    """Cut a doorway or window out of the walls on both sides of it; return the panel that closes it, or [].

    ``hole`` is its entry in the file; ``rooms`` are the names of the rooms. A door between two rooms is open.
    """
    first = walls[str(hole["wall0"])]
    corners = _points(hole["holePolygon"])  # relative to the first wall: along it and up
    (left, bottom), (right, top) = corners[:, [0, 2]].min(axis=0), corners[:, [0, 2]].max(axis=0)
    ends = [first.at(x, 0.0) for x in (left, right)]
    for wall in dict.fromkeys((first, walls.get(str(hole.get("wall1")), first))):
        places = sorted(float((end - wall.start) @ wall.along) for end in ends)
        a, b = max(places[0], 0.0), min(places[1], wall.width)
        if b > a:
            wall.holes.append((a, b, max(float(bottom), 0.0), min(float(top), wall.height)))
    sides = {str(hole.get("room0")), str(hole.get("room1"))} & rooms
    if door and len(sides) > 1:
        return []
    quad = np.array([[first.at(left, bottom), first.at(right, bottom), first.at(right, top), first.at(left, top)]])
    return [_quads(quad, (0.55, 0.38, 0.24) if door else (0.62, 0.78, 0.92))]


def _boxes(thing: dict[str, Any], doubtful: list[str], *, on_floor: bool) -> list[MeshPart]:
    """Return a box for an object, and boxes for the objects on it; append names without a published size."""
    name = str(thing.get("assetId") or thing.get("id", ""))
    size, published = asset_size(name)
    middle = _points([thing["position"]])[0]
    if size is None:
        size = np.full(3, _USUAL if on_floor else _SMALL)
    if not published:
        doubtful.append(name)
        if on_floor and 0.1 < 2.0 * middle[2] <= 1.6 * size[1]:  # it is on the floor, not on a wall
            size = np.array([size[0], 2.0 * middle[2], size[2]])
    turned = thing.get("rotation") or {}
    degrees = [float(turned.get(axis, 0.0)) for axis in "yxz"]  # Unity turns about z first, then x, then y
    if not max(map(abs, degrees)) < 1e6 or np.isnan(degrees).any():
        raise UnreadableMesh(f"the rotation of {short_repr(thing.get('id', name))} is not a finite number of degrees")
    corners = np.array([(x, y, z) for z in (-1, 1) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))], float)
    spun = Rotation.from_euler("YXZ", degrees, degrees=True).apply(0.5 * size * corners[:, [0, 2, 1]])
    placed = spun[:, [0, 2, 1]] + middle
    sides = [(0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]
    parts = [_quads(placed[np.array(sides)], _tint(name, "object"))]
    for child in _list(thing.get("children", []), "children", _MAX_OBJECTS):
        parts += _boxes(child, doubtful, on_floor=False)
    return parts


def _points(corners: Sequence[dict[str, Any]]) -> np.ndarray:  # [N, 3] metres, z up
    points = np.array([[float(p["x"]), float(p["z"]), float(p["y"])] for p in corners]).reshape(-1, 3)
    if not len(points) or not np.isfinite(points).all() or np.abs(points).max() > 1e4:
        raise UnreadableMesh("a position is not a finite number of metres")
    return points


def _polygon(corners: np.ndarray, tint: tuple[float, float, float]) -> MeshPart:
    triangles, _ = triangulated(corners, np.array([len(corners)]))
    return MeshPart(corners, triangles, np.tile(tint, (len(corners), 1)))


def _quads(quads: np.ndarray, tint: tuple[float, float, float]) -> MeshPart:  # [Q, 4, 3]
    first = 4 * np.arange(len(quads))[:, None]
    faces = np.concatenate([first + [0, 1, 2], first + [0, 2, 3]]).astype(np.int64)
    return MeshPart(quads.reshape(-1, 3), faces, np.tile(tint, (4 * len(quads), 1)))


def _tint(*words: str) -> tuple[float, float, float]:
    """Return a muted sRGB colour in 0..1, computed from a hash of the words."""
    number = zlib.crc32(" ".join(words).encode())
    return colorsys.hls_to_rgb(number % 360 / 360, 0.45 + (number >> 9) % 30 / 100, 0.2 + (number >> 17) % 30 / 100)


def _material(material: Any) -> str:
    return str(material.get("name", "")) if isinstance(material, dict) else str(material or "")


def _list(found: Any, what: str, most: int) -> list[Any]:
    if not isinstance(found, list):
        raise UnreadableMesh(f"its {what} are not a list")
    if len(found) > most:
        raise UnreadableMesh(f"it has {len(found)} {what}, more than {most}")
    return found
