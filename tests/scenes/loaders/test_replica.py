from __future__ import annotations

import shutil

import numpy as np
import pytest

from activestructure_gym.errors import InputError, InputWarning
from activestructure_gym.scenes import load_scene
from activestructure_gym.scenes.loaders.mesh_loader import load_mesh_scene
from activestructure_gym.scenes.loaders.replica import is_replica, load_replica_scene

FORMS = ["", "mesh.ply", "habitat", "habitat/mesh_semantic.ply", "habitat/replica_stage.stage_config.json"]


@pytest.mark.parametrize("form", FORMS)
def test_every_form_is_the_same_room(replica_folder, form):
    scene = load_replica_scene(replica_folder / "room_a" / form)
    assert scene.name == "room_a" and len(scene.mesh.faces) == 12
    np.testing.assert_allclose(scene.bounds, [[0, 0, 0], [4, 3, 2.5]])
    assert (scene.labels is not None) == form.startswith("habitat")
    assert scene.evaluation_views is None


def test_quads_become_triangles_with_the_quad_s_object(replica_folder):
    scene = load_replica_scene(replica_folder / "room_a" / "habitat")
    labels = scene.labels
    assert labels.names == ("floor 3", "wall 7", "lamp 9")
    assert labels.structural.tolist() == [True, True, False]
    centers = scene.mesh.vertices[scene.mesh.faces].mean(axis=1)
    names = [labels.names[part] for part in labels.face_part]
    for name, center in zip(names, centers):
        # In the fixture the floor (z = 0) is object 3, the ceiling object 9, the walls 7.
        expected = "floor 3" if center[2] == 0 else "lamp 9" if center[2] == 2.5 else "wall 7"
        assert name == expected


def test_trimesh_reads_the_same_surface_and_colours(replica_folder):
    path = replica_folder / "room_a" / "mesh.ply"
    ours, theirs = load_replica_scene(path).mesh, load_mesh_scene(path).mesh
    np.testing.assert_array_equal(ours.vertices, theirs.vertices)
    np.testing.assert_allclose(ours.colors, theirs.colors, atol=1e-6)
    triangles = [np.sort(np.sort(mesh.faces, axis=1).view("i4,i4,i4").ravel()) for mesh in (ours, theirs)]
    np.testing.assert_array_equal(*triangles)


def write_triangles(path, vertices, faces, colors):
    """A binary PLY with vertex colours of the given type, as reconstruction tools write it."""
    kind = {"u1": "uchar", "u2": "ushort", "f4": "float"}[colors.dtype.str[1:]]
    vertex = np.zeros(len(vertices), [("p", "<f4", 3), ("c", colors.dtype, 3)])
    vertex["p"], vertex["c"] = vertices, colors
    face = np.zeros(len(faces), [("count", "u1"), ("corners", "<i4", 3)])
    face["count"], face["corners"] = 3, faces
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertex)}"]
    header += [f"property float {axis}" for axis in "xyz"]
    header += [f"property {kind} {name}" for name in ("red", "green", "blue")]
    header += [f"element face {len(face)}", "property list uchar int vertex_indices", "end_header", ""]
    path.write_bytes("\n".join(header).encode() + vertex.tobytes() + face.tobytes())


@pytest.mark.parametrize(
    "colors",
    [
        np.array([[51, 102, 204]], np.uint8),
        np.array([[51, 102, 204]], np.uint16) * np.uint16(257),
        np.array([[0.2, 0.4, 0.8]], np.float32),
        np.array([[51, 102, 204]], np.float32),
    ],
)
def test_colours_are_shares_whatever_their_type(tmp_path, make_box, colors):
    vertices, faces = make_box((0, 0, 0), (4, 3, 2.5))
    write_triangles(tmp_path / "mesh.ply", vertices, faces, np.repeat(colors, 8, axis=0))
    scene = load_replica_scene(tmp_path)
    np.testing.assert_allclose(scene.mesh.colors, np.tile([[0.2, 0.4, 0.8]], (8, 1)), atol=1e-6)


def test_a_colour_that_is_none_is_painted_grey(tmp_path, make_box):
    colors = np.full((8, 3), 0.2, np.float32)
    colors[0] = np.nan
    write_triangles(tmp_path / "mesh.ply", *make_box((0, 0, 0), (4, 3, 2.5)), colors)
    with pytest.warns(InputWarning, match="1 vertices have colours .* painted grey"):
        scene = load_replica_scene(tmp_path)
    np.testing.assert_allclose(scene.mesh.colors[0], 0.7)


@pytest.fixture
def lying_down():
    """A furnished flat with y up."""
    mesh = load_scene("apartment?rooms=2&seed=1&lit=no").mesh
    return mesh.vertices[:, [0, 2, 1]] * np.float32([1, 1, -1]), mesh.faces


def test_anybody_s_mesh_ply_is_read_as_any_other_mesh(tmp_path, lying_down):
    folder = tmp_path / "my_flat"
    folder.mkdir()
    write_triangles(folder / "mesh.ply", *lying_down, np.full((len(lying_down[0]), 3), 100, np.uint8))
    assert not is_replica(folder)
    with pytest.raises(InputError, match="the geometry says y"):
        load_scene(str(folder))
    assert load_scene(str(folder), up="y").bounds[1, 2] < 3.0
    with pytest.warns(InputWarning, match="z is up in Replica, though the geometry says y"):
        load_scene(f"replica:{folder}")
    (folder / "mesh.ply").write_bytes(b"ply\n")
    assert not is_replica(folder)


@pytest.mark.parametrize("beside", ["textures/", "traj.txt", "semantic.json", "habitat/"])
def test_a_folder_with_files_of_the_dataset_is_replica_s(tmp_path, make_box, beside):
    write_triangles(tmp_path / "mesh.ply", *make_box((0, 0, 0), (4, 3, 2.5)), np.full((8, 3), 100, np.uint8))
    assert not is_replica(tmp_path)
    (tmp_path / beside).mkdir() if beside.endswith("/") else (tmp_path / beside).touch()
    assert is_replica(tmp_path)


def test_a_mesh_of_quads_or_a_scene_s_name_is_enough(tmp_path, make_box, replica_folder):
    shutil.copy(replica_folder / "room_a" / "mesh.ply", tmp_path)
    assert is_replica(tmp_path)
    room = tmp_path / "room_0"
    room.mkdir()
    write_triangles(room / "mesh.ply", *make_box((0, 0, 0), (4, 3, 2.5)), np.full((8, 3), 100, np.uint8))
    assert is_replica(room)


def test_a_sequence_comes_along_when_asked_for(replica_folder):
    scene = load_replica_scene(replica_folder / "room_a", sequence=replica_folder / "seq" / "room_a")
    assert len(scene.evaluation_views) == 3


def test_a_sequence_with_its_mesh_beside_it_is_a_scene(replica_folder, tmp_path):
    shutil.copytree(replica_folder / "seq", tmp_path / "seq")
    with pytest.raises(InputError, match="posed sequence without a mesh"):
        load_replica_scene(tmp_path / "seq" / "room_a")
    shutil.copy(replica_folder / "room_a" / "mesh.ply", tmp_path / "seq" / "room_a_mesh.ply")
    scene = load_replica_scene(tmp_path / "seq" / "room_a")
    assert scene.name == "room_a" and len(scene.evaluation_views) == 3


def _error(path) -> str:
    with pytest.raises(InputError) as caught:
        load_replica_scene(path)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_what_is_no_replica_scene(tmp_path, replica_folder):
    assert "is not a Replica scene" in _error(tmp_path)
    assert "there is no Replica scene" in _error(tmp_path / "mesh.ply")
    assert "no stage config" in _error(tmp_path / "a.stage_config.json")
    (tmp_path / "a.stage_config.json").write_text("{}")
    assert "names no .ply mesh" in _error(tmp_path / "a.stage_config.json")
    (tmp_path / "a.stage_config.json").write_text("[")
    assert "not a stage config" in _error(tmp_path / "a.stage_config.json")
    data = (replica_folder / "room_a" / "mesh.ply").read_bytes()
    for broken, said in (
        (b"", "no PLY header"),
        (data[:-20], "not a Replica mesh"),
        (data.replace(b"binary_little_endian", b"ascii"), "not binary_little_endian"),
        (data.replace(b"element face 6", b"element face 0"), "no faces"),
    ):
        (tmp_path / "mesh.ply").write_bytes(broken)
        assert said in _error(tmp_path)


def test_vertices_that_are_not_finite(tmp_path, replica_folder):
    data = bytearray((replica_folder / "room_a" / "mesh.ply").read_bytes())
    start = data.index(b"end_header\n") + len(b"end_header\n")
    data[start : start + 4] = np.float32(np.nan).tobytes()
    (tmp_path / "mesh.ply").write_bytes(data)
    assert "1 of 8 vertices that are not finite" in _error(tmp_path)


@pytest.mark.parametrize("form", FORMS)
def test_the_shared_fixture_loads_in_all_its_forms(shared, form):
    folder = shared / "scenes" / "replica_fixture"
    scene = load_replica_scene(folder / "room_fix" / form, sequence=folder / "seq" / "room_fix")
    assert scene.name == "room_fix" and len(scene.mesh.faces) == 2 * 680
    np.testing.assert_allclose(scene.bounds, [[0, 0, 0], [4, 3, 2.5]], atol=1e-6)
    assert len(scene.evaluation_views) == 12
    if form.startswith("habitat"):
        assert scene.labels.names[0] == "floor 1" and scene.labels.names[-1] == "table 7"
        assert scene.labels.structural.tolist() == [True] * 6 + [False]
