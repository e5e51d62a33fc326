"""Which way is up, from outside: what the terminal says, and where a recorded mesh is found."""

from __future__ import annotations

import os
import warnings
from pathlib import Path

import gymnasium as gym
import pytest
import trimesh

from activestructure_gym.errors import InputError, InputWarning
from activestructure_gym.evaluation.cli import main
from activestructure_gym.evaluation.running.recorded_scene import scene_as_recorded
from activestructure_gym.scenes import load_scene

WHY = "floor and ceiling lie 2.45 m apart along z, the shortest side"


@pytest.fixture(scope="module")
def rooms(tmp_path_factory) -> Path:
    """A room with two tables and an empty one, as glTF files with z up that do not say so."""
    folder = tmp_path_factory.mktemp("rooms")
    box = trimesh.creation.box((5.0, 4.0, 2.5))
    tables = [trimesh.creation.box((1.2, 1.5, 0.8)).apply_translation((x, 1.0, -0.85)) for x in (-1.4, 1.2)]
    trimesh.util.concatenate([box, *tables]).export(folder / "room.glb")
    trimesh.creation.box((4.0, 3.0, 2.5)).export(folder / "box.glb")
    return folder


def test_compare_refuses_and_says_how_to_go_on(rooms, capsys):
    assert main(["compare", "--scenes", f"{rooms}/room.glb"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f"y is up in glTF, but the geometry says z: {WHY}" in line
    assert line.endswith("give up=z to follow the geometry, or up=y to insist")


@pytest.mark.slow
def test_compare_scenes_and_the_environment_say_the_same(rooms, capsys):
    spec = f"{rooms}/room.glb?up=auto"
    # A start outside ends the command after the scenes are loaded.
    assert main(["compare", "--scenes", spec, "--start", "90,90,1.3,0"]) == 2
    told, _ = capsys.readouterr().err.splitlines()
    assert told.startswith(f"asg: note: room.glb: up=z by the geometry: {WHY}")
    note = told.removeprefix("asg: note: room.glb: ")
    assert main(["scenes", spec]) == 0
    captured = capsys.readouterr()
    assert note in captured.out and captured.err == ""
    env = gym.make("activestructure_gym:ActiveStructure/Mesh-v0", scene=spec, preset="fast")
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        env.reset(seed=0)
        env.reset(seed=1)
    env.close()
    assert [str(one.message) for one in said if one.category is InputWarning] == [f"room.glb: {note}"]


def test_a_record_of_another_mesh_is_refused(rooms):
    with pytest.raises(InputError, match="but the geometry says z"):
        scene_as_recorded(f"{rooms}/room.glb", "0" * 64)
    with pytest.raises(InputError, match="has changed since this run was planned: expected content 000000000000"):
        scene_as_recorded(f"{rooms}/box.glb", "0" * 64)
    with pytest.raises(InputError, match="has changed"):
        scene_as_recorded("box", "0" * 64)


def test_a_mesh_that_has_moved_is_known_by_its_content(rooms, tmp_path, monkeypatch):
    expected = load_scene(f"{rooms}/box.glb", up="z")
    record, other = tmp_path / "gone" / "box.glb", tmp_path / "elsewhere"
    other.mkdir()
    monkeypatch.chdir(tmp_path)
    with pytest.raises(
        InputError, match="has moved is found by its name in the working directory and in .* ASG_SCENES"
    ):
        scene_as_recorded(f"{record}?up=z", expected.content_hash)
    (other / "box.glb").write_bytes((rooms / "box.glb").read_bytes())
    for folder, variable in ((other, ""), (tmp_path, f"/nowhere{os.pathsep}{other}")):
        monkeypatch.chdir(folder)
        monkeypatch.setenv("ASG_SCENES", variable)
        moved = rf"gone/box.glb\?up=z' does not exist: '{other}/box.glb\?up=z' has the same"
        with pytest.warns(InputWarning, match=moved):
            found = scene_as_recorded(f"{record}?up=z", expected.content_hash)
        assert found.content_hash == expected.content_hash
    with pytest.raises(InputError, match="gone"):
        scene_as_recorded(f"{record}?up=z", "0" * 64)
