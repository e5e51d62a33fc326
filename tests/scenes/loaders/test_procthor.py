"""Houses of ProcTHOR: the layout of its files, with two rooms, a doorway, a window, an outer door and furniture."""

from __future__ import annotations

import copy
import gzip
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.ground_truth import ground_truth_of
from activestructure_gym.scenes import load_scene
from activestructure_gym.scenes.loaders.procthor import load_procthor_scene

HIGH = 2.6


def point(x: float, y: float, z: float) -> dict[str, float]:
    return {"x": x, "y": y, "z": z}


def wall(name: str, room: str, a: tuple[float, float], b: tuple[float, float]) -> dict[str, Any]:
    corners = [point(a[0], 0, a[1]), point(b[0], 0, b[1]), point(b[0], HIGH, b[1]), point(a[0], HIGH, a[1])]
    return {"id": name, "roomId": room, "polygon": corners, "material": {"name": "PureWhite"}}


def hole(name: str, first: str, second: str, rooms: tuple[str, str], low: tuple, high: tuple) -> dict[str, Any]:
    return {
        "id": name, "wall0": first, "wall1": second, "room0": rooms[0], "room1": rooms[1],
        "holePolygon": [point(*low, 0), point(*high, 0)], "assetId": "Doorway_1", "assetPosition": point(0, 0, 0),
    }  # fmt: skip


def house() -> dict[str, Any]:
    """Rooms of 4 x 3 m and 3 x 3 m side by side along x; the doorway is 1 m wide, from z = 0.5 to 1.5."""
    return {
        "metadata": {"schema": "1.0.0"},
        "proceduralParameters": {"ceilingMaterial": {"name": "White"}},
        "rooms": [
            {"id": "room|2", "roomType": "Bedroom", "floorMaterial": {"name": "Oak"}, "ceilings": [], "children": [],
             "floorPolygon": [point(0, 0, 0), point(0, 0, 3), point(4, 0, 3), point(4, 0, 0)]},
            {"id": "room|3", "roomType": "Kitchen", "floorMaterial": {"name": "Tile"}, "ceilings": [], "children": [],
             "floorPolygon": [point(4, 0, 0), point(4, 0, 3), point(7, 0, 3), point(7, 0, 0)]},
        ],
        "walls": [
            wall("a1", "room|2", (0, 0), (4, 0)), wall("a2", "room|2", (4, 0), (4, 3)),
            wall("a3", "room|2", (4, 3), (0, 3)), wall("a4", "room|2", (0, 3), (0, 0)),
            wall("b1", "room|3", (4, 0), (7, 0)), wall("b2", "room|3", (7, 0), (7, 3)),
            wall("b3", "room|3", (7, 3), (4, 3)), wall("b4", "room|3", (4, 3), (4, 0)),
        ],
        "doors": [
            hole("d1", "a2", "b4", ("room|2", "room|3"), (0.5, 0), (1.5, 2.1)),
            hole("d2", "b2", "exterior", ("room|3", "room|3"), (1, 0), (2, 2.1)),
        ],
        "windows": [hole("w1", "a4", "exterior", ("room|2", "room|2"), (1, 0.9), (2, 1.9))],
        "objects": [
            {"id": "Bed|2|0", "assetId": "Bed_4", "position": point(1.2, 0.3, 2.0), "rotation": point(0, 90, 0),
             "children": [{"id": "Pillow|0", "assetId": "Pillow_2", "position": point(1.2, 0.7, 2.0)}]},
            {"id": "Fridge|3|0", "assetId": "Fridge_11", "position": point(6.4, 0.9, 0.5), "rotation": point(0, 0, 0)},
        ],
    }  # fmt: skip


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "house_7.json"
    path.write_text(json.dumps(house()))
    return path


def test_walls_doorways_panes_and_floors_are_where_the_house_says(file: Path) -> None:
    scene = load_procthor_scene(file, objects=False)
    assert scene.name == "house_7"
    np.testing.assert_allclose(scene.bounds, [[0, 0, 0], [7, 3, HIGH]], atol=1e-6)

    def hit(origin: tuple[float, float, float], target: tuple[float, float, float]) -> bool:
        return bool(scene.raycaster.occluded(np.array([origin], float), np.array([target], float))[0])

    inside, beyond = (2.0, 1.0, 1.0), (5.0, 1.0, 1.0)
    assert not hit(inside, beyond)  # through the doorway, whose two walls face each other
    assert hit((2.0, 2.0, 1.0), (5.0, 2.0, 1.0)) and hit((2.0, 1.0, 2.4), (5.0, 1.0, 2.4))
    assert hit((6.0, 1.5, 1.0), (8.0, 1.5, 1.0))  # the door to the outside is closed
    assert hit((1.0, 1.5, 1.4), (-1.0, 1.5, 1.4)) and hit((1.0, 0.5, 1.4), (-1.0, 0.5, 1.4))  # pane and wall beside it
    assert hit((1.0, 1.0, 1.0), (1.0, 1.0, -1.0)) and hit((1.0, 1.0, 1.0), (1.0, 1.0, 4.0))
    whole = 2 * (7 * HIGH + 3 * HIGH) + 2 * 3 * HIGH + 2 * 21.0  # the wall between the rooms counts from both sides
    assert scene.mesh.vertices.dtype == np.float32
    corners = scene.mesh.vertices[scene.mesh.faces].astype(float)
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
    np.testing.assert_allclose(area, whole - 2 * 1.0 * 2.1, rtol=1e-5)


def test_walls_of_one_name_are_all_there(file: Path) -> None:
    whole = load_procthor_scene(file, objects=False)
    file.write_text(json.dumps(changed(("walls", 0, "id"), "b1")))
    assert load_procthor_scene(file, objects=False).content_hash == whole.content_hash


def test_where_two_rooms_are_one_there_is_no_wall(file: Path) -> None:
    """A wall that is said to be empty, as ProcTHOR's between a kitchen and a living room that are open."""
    content = house()
    content["doors"].pop(0)
    for one in content["walls"]:
        one["empty"] = one["id"] in ("a2", "b4")
    file.write_text(json.dumps(content))
    scene = load_procthor_scene(file, objects=False)
    ends = np.array([[2.0, 2.5, 2.4], [2.0, 0.5, 1.0]]), np.array([[5.0, 2.5, 2.4], [8.0, 0.5, 1.0]])
    np.testing.assert_array_equal(scene.raycaster.occluded(*ends), [False, True])  # open, but for the outer wall


def test_the_frame_is_not_mirrored(file: Path) -> None:
    """Their x is ours and their z our y: a left-handed frame with y up becomes a right-handed one with z up."""
    scene = load_procthor_scene(file)
    bed = scene.mesh.vertices[(np.abs(scene.mesh.vertices - [1.2, 2.0, 0.3]) < [1.1, 0.9, 0.31]).all(axis=1)]
    np.testing.assert_allclose(bed.min(axis=0), [0.2, 1.2, 0.0], atol=1e-5)  # 1.6 x 2 m, turned by 90 degrees
    np.testing.assert_allclose(bed.max(axis=0)[:2], [2.2, 2.8], atol=1e-5)


def test_furniture_is_boxes_as_high_as_their_middles_say_and_can_be_left_away(file: Path) -> None:
    full, empty = load_procthor_scene(file), load_procthor_scene(file, objects=False)
    assert len(full.mesh.faces) - len(empty.mesh.faces) == 3 * 12
    fridge = full.mesh.vertices[np.abs(full.mesh.vertices[:, :2] - [6.4, 0.5]).max(axis=1) < 0.45]
    assert abs(fridge[fridge[:, 2] < 2.0][:, 2].max() - 1.8) < 1e-5  # twice 0.9
    assert ground_truth_of(full).observable_surface.points.shape[0] > 1000


@pytest.mark.parametrize("ending", [".jsonl", ".jsonl.gz"])
def test_of_many_houses_one_is_chosen(tmp_path: Path, ending: str) -> None:
    second = house()
    second["objects"] = []
    path, text = tmp_path / f"train{ending}", "\n\n".join(json.dumps(one) for one in (house(), second)) + "\n"
    path.write_bytes(gzip.compress(text.encode()) if ending.endswith("gz") else text.encode())
    first, other = load_scene(f"procthor:{path}"), load_scene(f"procthor:{path}?house=1")
    assert first.name == "train-0" and len(first.mesh.faces) - len(other.mesh.faces) == 36
    with pytest.raises(InputError, match="it holds 2 houses, and number 2 was asked for"):
        load_scene(f"procthor:{path}?house=2")


def changed(path: tuple[Any, ...], value: Any) -> dict[str, Any]:
    content: Any = copy.deepcopy(house())
    place = content
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    return dict(content)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({}, "'walls' is missing"),
        ([], "a part of it is of another kind"),
        (changed(("walls",), {}), "its walls are no list"),
        (changed(("rooms", 0, "floorPolygon", 0, "x"), float("nan")), "no finite number"),
        (changed(("rooms", 0, "floorPolygon", 0, "x"), "left"), "could not convert"),
        (changed(("doors", 0, "wall0"), "z9"), "'z9' is missing"),
        (changed(("walls", 0, "polygon"), [point(0, 0, 0)] * 4), "has no width or no height"),
        (changed(("objects", 0, "position"), None), "a part of it is of another kind"),
        (changed(("objects", 0, "rotation"), {"y": float("nan")}), "the rotation of 'Bed|2|0' is no finite number"),
        (changed(("objects", 0, "rotation"), {"y": float("inf")}), "the rotation of 'Bed|2|0' is no finite number"),
    ],
)
def test_what_is_no_house_is_said(tmp_path: Path, content: Any, message: str) -> None:
    path = tmp_path / "house.json"
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match=f"'{path}' is no ProcTHOR house: .*{message}"):
        load_procthor_scene(path)


def test_what_is_no_file_of_houses_is_said(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no ProcTHOR file"):
        load_procthor_scene(tmp_path / "gone.json")
    (tmp_path / "house.glb").write_bytes(b"")
    with pytest.raises(InputError, match=r"is a file \.json, \.jsonl"):
        load_procthor_scene(tmp_path / "house.glb")
    (tmp_path / "deep.json").write_text("[" * 100_000)
    (tmp_path / "bad.jsonl.gz").write_bytes(b"\x1f\x8b no gzip")
    (tmp_path / "HOUSE.JSON.GZ").write_bytes(gzip.compress(json.dumps(house()).encode()))
    assert load_procthor_scene(tmp_path / "HOUSE.JSON.GZ").name == "HOUSE"
    for name in ("deep.json", "bad.jsonl.gz"):
        with pytest.raises(InputError, match="is no ProcTHOR house"):
            load_procthor_scene(tmp_path / name)
