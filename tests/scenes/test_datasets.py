"""Scenes of published datasets by name, and what a folder of them holds."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.scenes import load_scene
from activestructure_gym.scenes.dataset_check import check_dataset
from activestructure_gym.scenes.datasets import DATASETS, MATTERPORT3D, REPLICA, published_start


@pytest.fixture
def replica(replica_folder, tmp_path, monkeypatch):
    """office_2 as published, room0 as NICE-SLAM names it: a sequence with the mesh beside it."""
    root = tmp_path / "data"
    shutil.copytree(replica_folder / "room_a", root / "office_2")
    shutil.copytree(replica_folder / "seq" / "room_a", root / "Replica" / "room0")
    shutil.copy(replica_folder / "seq" / "cam_params.json", root / "Replica")
    shutil.copy(replica_folder / "room_a" / "mesh.ply", root / "Replica" / "room0_mesh.ply")
    monkeypatch.setenv("ASG_REPLICA", str(root))
    return root


@pytest.mark.parametrize("name", ["office_2", "office2", "Off2", "off2"])
def test_a_scene_is_found_by_each_of_its_names(replica, name):
    scene = load_scene(f"replica:{name}")
    assert scene.name == "office_2" and scene.labels is None


def test_a_download_for_slam_is_found_with_its_recorded_views(replica):
    scene = load_scene("replica:R0")
    assert scene.name == "room0" and len(scene.evaluation_views) == 3


def test_what_is_there_by_that_path_comes_first(replica, tmp_path, monkeypatch):
    shutil.copytree(replica / "office_2", tmp_path / "here" / "office_2")
    monkeypatch.chdir(tmp_path / "here")
    monkeypatch.delenv("ASG_REPLICA")
    assert load_scene("replica:office_2").name == "office_2"


@pytest.mark.parametrize("name", ["room0_mesh.ply", "room0.ply"])
def test_a_mesh_beside_the_sequence_is_found_under_either_name_and_by_itself(replica, name):
    mesh = (replica / "Replica" / "room0_mesh.ply").rename(replica / "Replica" / name)
    for left in ("with its views", "alone"):
        scene = next(scene for scene in check_dataset(REPLICA, replica) if scene.title == "R0")
        assert scene.usable and scene.files[0].name == mesh.name
        assert load_scene("replica:R0").name == "room0"
        if left != "alone":
            shutil.rmtree(replica / "Replica" / "room0")


def test_a_scene_that_is_not_found_is_one_sentence(replica, monkeypatch):
    with pytest.raises(InputError, match="no scene 'office_4' in it; `asg doctor --dataset replica"):
        load_scene("replica:Off4")
    with pytest.raises(InputError, match="ASG_MATTERPORT3D is not set.*; get the dataset from https"):
        load_scene("matterport3d:gZ6f")
    with pytest.raises(InputError, match="there is no Replica scene 'office_9'"):
        load_scene("replica:office_9")  # nobody's name


def test_a_house_is_found_by_its_title(tmp_path, gltf, make_box, monkeypatch):
    folder = tmp_path / "mp3d" / "gZ6f7yhEvPG"
    folder.mkdir(parents=True)
    gltf.triangle_mesh(*make_box((-3, -2, 0), (3, 2, 2.6)))
    gltf.write(folder / "gZ6f7yhEvPG.glb")
    monkeypatch.setenv("ASG_MATTERPORT3D", str(tmp_path))
    assert load_scene("matterport3d:gZ6f").name == load_scene("matterport3d:gZ6f7yhEvPG").name == "gZ6f7yhEvPG"
    states = {scene.title: scene for scene in check_dataset(MATTERPORT3D, tmp_path)}
    assert states["gZ6f"].usable and states["gZ6f"].place == folder and not states["Gdv"].usable
    whole = (folder / "gZ6f7yhEvPG.glb").read_bytes()
    (folder / "gZ6f7yhEvPG.glb").write_bytes(whole + b"more")  # which readers do not look at
    assert next(scene for scene in check_dataset(MATTERPORT3D, tmp_path) if scene.title == "gZ6f").usable
    assert load_scene("matterport3d:gZ6f").name == "gZ6f7yhEvPG"
    for damaged, why in ((whole[:-1], "cut off"), (b"glTX" + whole[4:], "does not begin"), (b"", "does not begin")):
        (folder / "gZ6f7yhEvPG.glb").write_bytes(damaged)
        (state,) = next(scene for scene in check_dataset(MATTERPORT3D, tmp_path) if scene.title == "gZ6f").files
        assert state.state == "damaged" and state.needed and why in state.why


def test_a_mesh_that_may_not_be_opened_is_damaged(tmp_path, monkeypatch):
    folder = tmp_path / "gZ6f7yhEvPG"
    folder.mkdir()
    (folder / "gZ6f7yhEvPG.glb").touch()

    def refused(path, *_, **__):
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr("builtins.open", refused)
    (file,) = next(scene for scene in check_dataset(MATTERPORT3D, tmp_path) if scene.place).files
    assert file.state == "damaged" and "Permission denied" in file.why


def test_lists_that_are_no_faces_may_be_empty(replica):
    """Texture coordinates, say: the header does not tell how long they are."""
    lines = [b"ply", b"format binary_little_endian 1.0", b"element vertex 3", b"property float x", b"element face 2"]
    lines += [b"property list uchar int vertex_indices", b"property list uchar float texcoord", b"end_header", b""]
    content = b"\n".join(lines) + bytes(3 * 4) + 2 * (b"\3" + bytes(12) + b"\0")
    (replica / "office_2" / "mesh.ply").write_bytes(content)
    for end, state in ((len(content), "there"), (-1, "damaged")):
        (replica / "office_2" / "mesh.ply").write_bytes(content[:end])
        scene = next(scene for scene in check_dataset(REPLICA, replica) if scene.title == "Off2")
        assert {file.name: file.state for file in scene.files}["mesh.ply"] == state


def test_every_file_of_a_scene_is_judged(replica):
    def files(title):
        scene = next(scene for scene in check_dataset(REPLICA, replica) if scene.title == title)
        return scene.usable, {file.name: file.state for file in scene.files}

    whole = {"mesh.ply": "there", "habitat/mesh_semantic.ply": "there", "habitat/info_semantic.json": "there"}
    assert files("Off2") == (True, {**whole, "traj.txt": "missing"})
    assert files("R0") == (True, {"room0_mesh.ply": "there", "habitat/info_semantic.json": "missing"})
    assert files("Off0") == (False, {})
    mesh = replica / "office_2" / "mesh.ply"
    content = mesh.read_bytes()
    for damaged in (content[:-40], content[:20], b"nothing", b""):
        mesh.write_bytes(damaged)
        usable, states = files("Off2")
        assert not usable and states["mesh.ply"] == "damaged"
    (replica / "office_2" / "habitat" / "info_semantic.json").write_text("{")
    mesh.write_bytes(content)
    assert files("Off2") == (True, {**whole, "habitat/info_semantic.json": "damaged", "traj.txt": "missing"})
    mesh.unlink()
    assert files("Off2")[0]  # the semantic mesh is the same surface
    (replica / "office_2" / "habitat" / "mesh_semantic.ply").unlink()
    assert files("Off2")[1]["mesh.ply"] == "missing" and not files("Off2")[0]
    with pytest.raises(InputError, match="there is no folder"):
        check_dataset(REPLICA, replica / "nowhere")


def test_titles_and_folders_are_nobody_else_s():
    for dataset in DATASETS.values():
        assert {dataset.folder_of(title) for title in dataset.scenes} == set(dataset.scenes.values())
        assert all(dataset.folder_of(folder.lower()) == folder for folder in dataset.scenes.values())
        assert dataset.folder_of("nobody") is None


def test_papers_start_at_a_configured_pose_or_the_sequences_first(replica, make_scene_named):
    x, y, z, yaw = published_start(load_scene("replica:R0"))
    # The sequence was written at (1.5, 1.2, 1.4), its first camera turned by .3 rad.
    assert (x, y, z) == pytest.approx((1.5, 1.2, 1.4)) and yaw == pytest.approx(np.degrees(0.3))
    assert published_start(make_scene_named("YmJkqBEsHnH")) == (0.0, -2.0, 1.75, 180.0)
    assert set(MATTERPORT3D.starts) == set(MATTERPORT3D.scenes.values())
    for scene in (load_scene("replica:Off2"), make_scene_named("kitchen")):
        with pytest.raises(InputError, match="no start is published"):
            published_start(scene)


@pytest.fixture
def make_scene_named():
    return lambda name: replace(load_scene("box"), name=name)
