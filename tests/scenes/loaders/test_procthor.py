"""Houses of ProcTHOR: the layout of its files, with two rooms, a doorway, a window, an outer door and furniture."""

from __future__ import annotations

import copy
import gzip
import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from activestructure_gym.envs import ReconstructionEnv
from activestructure_gym.errors import InputError, InputWarning
from activestructure_gym.evaluation.running.episode import path_collisions
from activestructure_gym.ground_truth import ground_truth_of
from activestructure_gym.scenes import load_scene
from activestructure_gym.scenes.loaders.procthor import _boxes, load_procthor_scene
from activestructure_gym.scenes.loaders.procthor_sizes import _tables

HOUSES = Path(__file__).resolve().parents[4] / "shared" / "data" / "procthor"
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
            wall("a1", "room|2", (4, 0), (0, 0)), wall("a2", "room|2", (4, 3), (4, 0)),
            wall("a3", "room|2", (0, 3), (4, 3)), wall("a4", "room|2", (0, 0), (0, 3)),
            wall("b1", "room|3", (7, 0), (4, 0)), wall("b2", "room|3", (7, 3), (7, 0)),
            wall("b3", "room|3", (4, 3), (7, 3)), wall("b4", "room|3", (4, 0), (4, 3)),
        ],
        "doors": [
            hole("d1", "a2", "b4", ("room|2", "room|3"), (1.5, 0), (2.5, 2.1)),
            hole("d2", "b2", "exterior", ("room|3", "room|3"), (1, 0), (2, 2.1)),
        ],
        "windows": [hole("w1", "a4", "exterior", ("room|2", "room|2"), (1, 0.9), (2, 1.9))],
        "objects": [
            {"id": "Bed|2|0", "assetId": "Bed_18_2", "position": point(1.2, 0.792, 2.0), "rotation": point(0, 90, 0),
             "children": [{"id": "Book|0", "assetId": "Book_2", "position": point(1.2, 0.7, 2.0)}]},
            {"id": "Fridge|3|0", "assetId": "Fridge_11", "position": point(6.4, 0.983, 0.5),
             "rotation": point(0, 0, 0)},
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


def test_each_room_sees_its_own_side_of_a_wall(file: Path) -> None:
    content = house()
    for one in content["walls"]:
        one["material"] = {"name": one["roomId"]}
    for walls in (content["walls"], content["walls"][::-1]):
        file.write_text(json.dumps(content | {"walls": walls}))
        mesh, caster = (scene := load_procthor_scene(file, objects=False)).mesh, scene.raycaster
        seen = []
        for eye in ((2.0, 1.5, 1.0), (5.5, 1.5, 1.0)):
            sides = np.array([(4.0, y, z) for y in (2.0, 2.3, 2.9) for z in (0.3, 1.1, 2.5)])
            outer = np.array([(x, 3.0, 1.0) for x in np.linspace(-0.2, 0.2, 5) + eye[0]])
            faces = caster.cast(np.array(eye), np.concatenate([sides, outer]) - eye, fronts=True).face
            (color,) = np.unique(mesh.colors[mesh.faces[faces]].reshape(-1, mesh.colors.shape[-1]), axis=0)
            seen.append(tuple(color))
        assert seen[0] != seen[1]


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


def box_of(file: Path, **thing: Any) -> np.ndarray:
    """The lowest and highest corner [2, 3] of the box that one object adds to the house."""
    empty = load_procthor_scene(file, objects=False)
    file.write_text(json.dumps(changed(("objects",), [thing])))
    corners = load_procthor_scene(file).mesh.vertices[len(empty.mesh.vertices) :]
    return np.array([corners.min(axis=0), corners.max(axis=0)], dtype=np.float64)


def test_the_frame_is_not_mirrored(file: Path) -> None:
    """Their x is ours and their z our y: a left-handed frame with y up becomes a right-handed one with z up."""
    scene = load_procthor_scene(file, objects=False)
    floor = scene.mesh.vertices[scene.mesh.vertices[:, 2] == 0]
    assert floor[:, 0].max() == 7 and floor[:, 1].max() == 3


@pytest.mark.parametrize(
    ("turned", "sides"),  # Bed_18_2 is 1.150 m wide (x), 1.584 m high (y) and 1.859 m long (z)
    [((0, 0, 0), (1.150, 1.859, 1.584)), ((0, 90, 0), (1.859, 1.150, 1.584)), ((270, 0, 0), (1.150, 1.584, 1.859)),
     ((0, 0, 90), (1.584, 1.859, 1.150)), ((90, 90, 0), (1.584, 1.150, 1.859))],
)  # fmt: skip
def test_furniture_has_the_published_size_and_is_turned_as_in_unity(
    file: Path, turned: tuple[int, int, int], sides: tuple[float, float, float]
) -> None:
    low, high = box_of(file, assetId="Bed_18_2", position=point(2.0, 1.2, 1.5), rotation=point(*turned))
    np.testing.assert_allclose(high - low, sides, atol=1e-5)
    np.testing.assert_allclose(0.5 * (low + high), [2.0, 1.5, 1.2], atol=1e-5)


def test_furniture_turns_clockwise_when_seen_from_above(file: Path) -> None:
    """The left front corner of a box, turned by 30 degrees."""
    box_of(file, assetId="Bed_18_2", position=point(2.0, 0.8, 1.5), rotation=point(0, 30, 0))
    corner = Rotation.from_euler("z", -30, degrees=True).apply([-0.575, 0.9295, 0.792]) + [2.0, 1.5, 0.8]
    gaps = np.linalg.norm(load_procthor_scene(file).mesh.vertices - corner, axis=1)
    assert gaps.min() < 1e-5


def test_faces_of_furniture_look_outward(file: Path) -> None:
    empty = load_procthor_scene(file, objects=False)
    file.write_text(json.dumps(changed(("objects", 0, "children"), [])))
    mesh = load_procthor_scene(file).mesh
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces[len(empty.mesh.faces) :][:12]].astype(float), 1, 0)
    assert (np.einsum("ij,ij->i", np.cross(b - a, c - a), a - [1.2, 2.0, 0.792]) > 0).all()


def test_furniture_can_be_left_away(file: Path) -> None:
    full, empty = load_procthor_scene(file), load_procthor_scene(file, objects=False)
    assert len(full.mesh.faces) - len(empty.mesh.faces) == 3 * 12
    assert ground_truth_of(full).observable_surface.points.shape[0] > 1000


@pytest.mark.parametrize(
    ("asset", "centre", "sides"),
    [
        ("Fridge_999", 0.9, (None, None, 1.8)),  # the median of the fridges, twice as high as its centre
        ("Fridge_999", 2.4, (None, None, None)),  # on a wall: the median
        ("Harpsichord", 2.0, (0.4, 0.4, 0.4)),
    ],
)
def test_an_unlisted_asset_has_the_median_size_of_its_kind_and_is_reported(
    file: Path, asset: str, centre: float, sides: tuple[float | None, ...]
) -> None:
    listed = np.array([size for name, size in _tables()[0].items() if name.startswith("Fridge")])
    usual = np.median(listed, axis=0)[[0, 2, 1]]
    with pytest.warns(InputWarning, match=f"1 objects are no asset of ProcTHOR's database.*'{asset}'"):
        low, high = box_of(file, assetId=asset, position=point(2.0, centre, 1.5))
    np.testing.assert_allclose(high - low, [u if s is None else s for s, u in zip(sides, usual)], atol=1e-5)


def test_the_sizes_are_those_of_all_published_assets() -> None:
    sizes, kinds = _tables()
    assert len(sizes) == 1653 and 200 < len(kinds) < 300
    assert all(size.shape == (3,) and (size > 0.003).all() and (size < 3.1).all() for size in sizes.values())
    published = HOUSES / "asset-database.json"
    if published.is_file():
        for one in itertools.chain.from_iterable(json.loads(published.read_text()).values()):
            box = [one["boundingBox"][axis] for axis in "xyz"]
            np.testing.assert_allclose(sizes[one["assetId"]], box, atol=5.1e-4)


@pytest.mark.skipif(not HOUSES.is_dir(), reason="the published houses are not here")
def test_furniture_of_the_published_houses_is_on_the_floor_and_in_no_wall() -> None:
    """Their furniture has a published place: none below the floor, none deeper in a wall than 2 cm."""
    things, on_floor = 0, 0
    for file in sorted(HOUSES.glob("*_house_*.json")):
        content = json.loads(file.read_text())
        walls = np.array(
            [[[p["x"], p["z"]] for p in wall["polygon"]] for wall in content["walls"] if not wall.get("empty")]
        )
        ends = np.stack([walls.min(axis=1), walls.max(axis=1)], axis=1)  # [W, 2, 2]: along x or along y
        for thing in content["objects"]:
            corners = _boxes({**thing, "children": []}, [], on_floor=True)[0].vertices
            low, high = corners.min(axis=0), corners.max(axis=0)
            assert low[2] > -0.001
            things, on_floor = things + 1, on_floor + (low[2] < 0.001)
            if min(thing["rotation"]["y"] % 90, -thing["rotation"]["y"] % 90) < 1:
                inner = np.minimum(ends[:, 1], high[:2] - 0.02) - np.maximum(ends[:, 0], low[:2] + 0.02)
                assert not (inner >= 0).all(axis=1).any(), f"{thing['id']} of {file.name} is in a wall"
    assert things > 500 and on_floor > 0.6 * things  # the others hang on walls


@pytest.mark.slow
@pytest.mark.skipif(not HOUSES.is_dir(), reason="the published houses are not here")
def test_all_published_houses_load_and_play_without_a_step_through_the_mesh() -> None:
    files = sorted(HOUSES.glob("*_house_*.json"))
    assert len(files) >= 18
    short: dict[str, Any] = {"preset": "fast", "frame_budget": 60, "config": {"mapper.iterations": 1}}
    for file in files:
        env = ReconstructionEnv(scene=f"procthor:{file}", **short)
        env.reset(seed=0)
        rng, over = np.random.default_rng(0), False
        while not over:
            _, _, ended, cut, _ = env.step(rng.choice(np.flatnonzero(env.action_masks())))
            over = ended or cut
        scene, path = load_scene(f"procthor:{file}"), np.stack(env.reconstruction.trajectory)
        assert scene.notes[0].endswith("plausible")
        assert path_collisions(scene, path) == 0, file.name
        assert env.reconstruction.frames == 60 and env.reconstruction.metres > 0.5, file.name


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
        (changed(("walls",), {}), "its walls are not a list"),
        (changed(("rooms", 0, "floorPolygon", 0, "x"), float("nan")), "not a finite number"),
        (changed(("rooms", 0, "floorPolygon", 0, "x"), "left"), "could not convert"),
        (changed(("doors", 0, "wall0"), "z9"), "'z9' is missing"),
        (changed(("walls", 0, "polygon"), [point(0, 0, 0)] * 4), "has no width or no height"),
        (changed(("objects", 0, "position"), None), "a part of it is of another kind"),
        (changed(("objects", 0, "rotation"), {"y": float("nan")}), "the rotation of 'Bed|2|0' is not a finite number"),
        (changed(("objects", 0, "rotation"), {"y": float("inf")}), "the rotation of 'Bed|2|0' is not a finite number"),
    ],
)
def test_what_is_no_house_is_said(tmp_path: Path, content: Any, message: str) -> None:
    path = tmp_path / "house.json"
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match=f"'{path}' is not a ProcTHOR house: .*{message}"):
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
        with pytest.raises(InputError, match="is not a ProcTHOR house"):
            load_procthor_scene(tmp_path / name)
