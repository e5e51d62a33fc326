from __future__ import annotations

import time

import numpy as np
import pytest

from activestructure_gym.errors import InputError, InputWarning
from activestructure_gym.scenes import load_scene
from activestructure_gym.scenes.loaders.mesh_loader import load_mesh_scene, upright
from activestructure_gym.scenes.loaders.upright import UP_AXES, which_way_is_up

# The scenes' z axis in file axes: what an exporter with another up axis does.
FILE_FROM_WORLD = {
    "z": np.eye(3),
    "-z": np.diag([1.0, -1.0, -1.0]),
    "y": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
    "-y": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
    "x": np.array([[0, 0, 1.0], [0, 1, 0], [-1, 0, 0]]),
    "-x": np.array([[0, 0, -1.0], [0, 1, 0], [1, 0, 0]]),
}
YAW = np.array([[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1.0]])


def verdicts(vertices: np.ndarray, faces: np.ndarray) -> dict[str, str | None]:
    """What is told, per axis that is up in truth."""
    return {up: which_way_is_up(vertices @ turn.T, faces).up for up, turn in FILE_FROM_WORLD.items()}


@pytest.fixture(
    scope="module",
    params=[
        "room?seed=4",
        "apartment?seed=2&rooms=2",
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("room?seed=1", "apartment?seed=5&rooms=4")),
    ],
)
def furnished(request):
    mesh = load_scene(f"{request.param}&lit=false").mesh
    return mesh.vertices.astype(np.float64), mesh.faces


@pytest.fixture(scope="module")
def room():
    mesh = load_scene("room?seed=1&lit=false").mesh
    return mesh.vertices.astype(np.float64), mesh.faces


@pytest.mark.parametrize("kind", ["as it is", "turned by 37 degrees", "without a ceiling", "noisy and full of holes"])
def test_furnished_rooms_tell_all_six_axes(furnished, kind, rng):
    vertices, faces = furnished
    if kind.startswith("turned"):
        vertices = vertices @ YAW.T
    elif kind.startswith("without"):
        faces = faces[vertices[faces][:, :, 2].min(axis=1) < vertices[:, 2].max() - 0.45]
    elif kind.startswith("noisy"):
        vertices = vertices + rng.normal(0, 0.005, vertices.shape)
        faces = faces[rng.random(len(faces)) < 0.8]
    assert verdicts(vertices, faces) == {up: up for up in UP_AXES}


@pytest.mark.parametrize("name", ["hotel_room.glb", "bookstore.glb", "garage.glb", "home_theater.glb"])
def test_scenes_of_other_makers_tell_all_six_axes(shared, name):
    mesh = load_mesh_scene(shared / "scenes" / name, up="z").mesh
    assert verdicts(mesh.vertices.astype(np.float64), mesh.faces) == {up: up for up in UP_AXES}


def test_the_replica_fixture_tells(shared):
    mesh = load_mesh_scene(shared / "scenes" / "replica_fixture" / "room_fix" / "mesh.ply", up="z").mesh
    assert verdicts(mesh.vertices.astype(np.float64), mesh.faces) == {up: up for up in UP_AXES}


@pytest.mark.parametrize(
    "size, possible",
    [
        ((4, 3, 2.5), "y z"),  # an empty box may stand on any of two sides
        ((8, 7, 2.6), "z"),  # a large one only on one, but on either face of it
        ((30, 2.2, 2.5), "x y z"),  # a corridor: its walls are larger than its floor
        ((3, 3, 3), "x y z"),
        ((400, 300, 250), "x y z"),  # no room: the unit is wrong
    ],
)
def test_empty_boxes_do_not_tell(make_box, size, possible):
    verdict = which_way_is_up(*make_box((0, 0, 0), size))
    assert verdict.up is None
    assert {axis[-1] for axis in verdict.possible} == set(possible.split())
    assert {f"-{axis}" for axis in possible.split()} <= set(verdict.possible)


def test_a_ball_and_a_sheet_do_not_tell():
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=4, radius=2.0)
    assert which_way_is_up(ball.vertices, ball.faces).possible == UP_AXES
    sheet = np.array([[0.0, 0, 0], [4, 0, 0], [4, 3, 0]])
    assert "flat" in which_way_is_up(sheet, np.array([[0, 1, 2]])).reason
    assert which_way_is_up(sheet, np.zeros((1, 3), int)).up is None


def test_what_hangs_counts_against_what_stands(make_box, join):
    """A table tells the floor; the same table under the ceiling as well tells nothing."""
    box = make_box((0, 0, 0), (5, 4, 2.5))
    stands = [make_box((x, 1, 0.0), (x + 1.2, 2.5, 0.8)) for x in (0.5, 3)]
    hangs = [make_box((x, 1, 1.7), (x + 1.2, 2.5, 2.5)) for x in (0.5, 3)]
    assert verdicts(*join(box, *stands)) == {up: up for up in UP_AXES}
    assert which_way_is_up(*join(box, *hangs)).up == "-z"
    assert which_way_is_up(*join(box, *stands, *hangs)).up is None


def test_it_is_cheap_and_the_same_every_time(room):
    vertices, faces = room
    many = np.concatenate([faces] * (1 + 100_000 // len(faces)))[:100_000]
    assert which_way_is_up(vertices, many) == which_way_is_up(vertices, many)
    seconds = []
    for _ in range(5):
        began = time.process_time()
        which_way_is_up(vertices, many)
        seconds.append(time.process_time() - began)
    assert min(seconds) < 0.1  # 0.03 on an idle core


# -- what the loader makes of it --------------------------------------------------------------------------------------


@pytest.fixture
def write(tmp_path, gltf):
    """Writes a room into a file with ``up`` up, and what else the header of glTF shall hold; returns its path."""

    def write_room(room, up: str, suffix: str = ".glb", **header):
        vertices, faces = room
        path = tmp_path / f"{up}{suffix}"
        turned = (vertices @ FILE_FROM_WORLD[up].T + 0.0).astype(np.float32)
        if suffix in (".glb", ".gltf"):
            writer = type(gltf)()
            writer.triangle_mesh(turned, faces)
            writer.header |= header
            return writer.write(path)
        import trimesh

        trimesh.Trimesh(turned, faces, process=False).export(path)
        return path

    return write_room


@pytest.fixture
def loads():
    """Loads and returns the scene with the one warning, if any."""

    def load(path, **options):
        import warnings

        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            scene = load_mesh_scene(path, **options)
        told = [str(warning.message) for warning in said if warning.category is InputWarning]
        assert len(told) <= 1 and not any("\n" in text for text in told)
        return scene, "".join(told)

    return load


def error(path, **options) -> str:
    with pytest.raises(InputError) as caught:
        load_mesh_scene(path, **options)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("suffix, up", [(".glb", "y"), (".gltf", "y"), (".ply", "z"), (".obj", "z"), (".stl", "z")])
def test_the_rule_of_the_format_is_silent_where_the_geometry_agrees(room, write, loads, suffix, up):
    scene, told = loads(write(room, up, suffix))
    assert told == ""
    np.testing.assert_allclose(scene.bounds, [room[0].min(axis=0), room[0].max(axis=0)], atol=1e-6)
    assert not any("is up" in note for note in scene.notes)


@pytest.mark.parametrize("suffix, up, rule", [(".glb", "z", "y"), (".ply", "y", "z"), (".glb", "-y", "y")])
def test_a_file_that_lies_on_its_side_is_refused(room, write, loads, suffix, up, rule):
    path = write(room, up, suffix)
    message = error(path)
    assert f"{rule} is up" in message and f"but the geometry says {up}: floor and ceiling lie 2.6" in message
    assert message.endswith(f"give up={up} to follow the geometry, or up={rule} to insist")
    scene, told = loads(path, up=up)
    assert told == "" and scene.bounds[1, 2] - scene.bounds[0, 2] == pytest.approx(np.ptp(room[0][:, 2]), abs=1e-6)
    scene, told = loads(path, up=rule)
    assert f"up={rule}, though the geometry says {up}: floor and ceiling" in told
    assert any(note in told for note in scene.notes[1:])


def asset(**extras) -> dict:
    return {"version": "2.0", "extras": extras}


@pytest.mark.parametrize(
    "header",
    [
        {"asset": asset(up="z")},
        {"scene": 1, "scenes": [{"nodes": [0]}, {"nodes": [0], "extras": {"up": " Z "}}]},
        {"asset": asset(generator=3), "scenes": [{"nodes": [0], "extras": {"up": "z"}}]},
    ],
)
def test_a_file_may_say_that_it_is_z_up(room, write, loads, header):
    path = write(room, "z", **header)
    scene, told = loads(path)
    assert told == ""
    np.testing.assert_allclose(scene.bounds, [room[0].min(axis=0), room[0].max(axis=0)], atol=1e-6)
    assert "though the geometry says z" in loads(path, up="y")[1]  # options win


def test_what_the_file_says_stands_against_the_geometry(room, write, loads):
    scene, told = loads(write(room, "z", asset=asset(up="x")))
    assert told.startswith("z.glb: ") and "x is up by its extras, though the geometry says z" in told
    assert scene.bounds[1, 2] - scene.bounds[0, 2] == pytest.approx(np.ptp(room[0][:, 0]), abs=1e-6)


@pytest.mark.parametrize("extras", [None, 5, "z", ["up"], {"up": 3}, {"up": None}, {"height": "z"}])
def test_extras_of_other_programs_mean_nothing(room, write, loads, extras):
    assert loads(write(room, "y", asset={"version": "2.0", "extras": extras}))[1] == ""


def test_a_marker_that_is_no_axis(room, write, loads):
    path = write(room, "y", asset=asset(up="north"))
    assert "'north' is up by its extras, expected one of x, y, z, -x, -y, -z" in error(path)
    assert loads(path, up="y")[1] == ""


@pytest.mark.parametrize("up", UP_AXES)
def test_auto_says_what_it_decided_and_why(room, write, loads, up):
    scene, told = loads(write(room, up), up="auto")
    assert f"up={up} by the geometry: floor and ceiling lie 2.6" in told and told.split(": ", 1)[1] in scene.notes
    np.testing.assert_allclose(scene.bounds[:, 2], [room[0][:, 2].min(), room[0][:, 2].max()], atol=1e-6)


def test_auto_refuses_to_guess(tmp_path, write, make_box):
    path = write(make_box((0, 0, 0), (4, 3, 2.5)), "y")
    assert error(path, up="auto").endswith("give it, for example up=y or up=z")
    assert "cannot determine the up axis: floor and ceiling lie" in error(path, up="auto")
    # A wrong unit is the likelier reason, and is what the message is about.
    huge = write(make_box((0, 0, 0), (4000, 3000, 2500)), "y", ".ply")
    assert error(huge, up="auto").endswith("try units=mm (4.0 x 2.5 x 3.0 m) or units=cm (40.0 x 25.0 x 30.0 m)")
    assert "unknown up axis 'w'" in error(path, up="w") and "auto" in error(path, up="w")


def test_where_the_geometry_cannot_tell_the_rule_stands_with_a_note(write, loads, make_box):
    scene, told = loads(write(make_box((0, 0, 0), (4, 3, 2.5)), "y"))
    assert "y is up in glTF; the geometry cannot tell: floor and ceiling lie" in told
    np.testing.assert_allclose(np.ptp(scene.bounds, axis=0), [4, 3, 2.5], atol=1e-6)


# -- equal results ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("up", UP_AXES)
def test_a_scene_is_the_same_to_the_last_bit_whatever_its_file_calls_up(room, write, up, rng):
    vertices, faces = room
    vertices = vertices.astype(np.float32).astype(np.float64) - np.float32(2.0)  # both signs, and zeros
    vertices[:50] = 0.0
    expected = load_mesh_scene(write((vertices, faces), "z", ".ply"), up="z").mesh.vertices
    scene = load_mesh_scene(write((vertices, faces), up, ".ply"), up=up)
    np.testing.assert_array_equal(scene.mesh.vertices.view(np.int32), expected.view(np.int32))


def test_y_up_and_z_up_files_give_equal_episodes(room, write):
    from activestructure_gym.envs import ReconstructionEnv

    plain, marked = write(room, "y"), write(room, "z", asset=asset(up="z"))
    small = {"sensor": {"width": 64, "height": 36}, "views": {"max_candidates": 24}}
    episodes = []
    for path in (plain, marked):
        env = ReconstructionEnv(str(path), preset="fast", frame_budget=25, config=small)
        seen, info = env.reset(seed=3)
        arrays, ended = [seen], False
        while not ended:
            seen, reward, terminated, truncated, info = env.step(int(np.flatnonzero(info["action_mask"])[-1]))
            arrays.append(seen | {"reward": reward})
            ended = terminated or truncated
        episodes.append(arrays)
        env.close()
    assert load_scene(str(plain)).content_hash == load_scene(str(marked)).content_hash
    assert len(episodes[0]) == len(episodes[1]) > 2
    for one, other in zip(*episodes):
        assert one.keys() == other.keys()
        for name in one:
            np.testing.assert_array_equal(one[name], other[name], err_msg=name)


def test_upright_is_exact():
    vertices = np.random.default_rng(0).normal(size=(100, 3))
    for up in UP_AXES:
        np.testing.assert_array_equal(upright(vertices @ FILE_FROM_WORLD[up].T, up), vertices)


def as_y_up(path, out):
    """The same glTF file with all its roots below one node that stands the scene on its y axis, exactly."""
    import json
    import struct

    data = path.read_bytes()
    size = struct.unpack_from("<I", data, 12)[0]
    header = json.loads(data[20 : 20 + size])
    scene = header["scenes"][header.get("scene", 0)]
    matrix = np.eye(4)
    matrix[:3, :3] = FILE_FROM_WORLD["y"]
    header["nodes"].append({"matrix": matrix.T.reshape(-1).tolist(), "children": scene["nodes"]})
    scene["nodes"] = [len(header["nodes"]) - 1]
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + size :]
    length = 20 + len(text) + len(rest)
    out.write_bytes(struct.pack("<4sII", b"glTF", 2, length) + struct.pack("<I4s", len(text), b"JSON") + text + rest)
    return out


@pytest.mark.parametrize("name", ["hotel_room", "bookstore", "garage", "home_theater"])
def test_real_scenes_with_y_up_are_those_with_z_up(shared, tmp_path, loads, name):
    scene, told = loads(as_y_up(shared / "scenes" / f"{name}.glb", tmp_path / "y.glb"))
    assert told == ""
    assert scene.content_hash == load_mesh_scene(shared / "scenes" / f"{name}.glb", up="z").content_hash
    assert "up=y by the geometry" in loads(tmp_path / "y.glb", up="auto")[1]
