from __future__ import annotations

import shutil

import numpy as np
import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.scenes.loaders.mesh_loader import load_mesh_scene
from activestructure_gym.scenes.loaders.replica import load_replica_scene

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
    assert "is no Replica scene" in _error(tmp_path)
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
