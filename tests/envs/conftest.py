"""Every registered environment, made small enough to test, with scenes written by the tests themselves."""

from __future__ import annotations

from typing import Any

import pytest
import trimesh

from activestructure_gym.envs import ENV_IDS

SMALL: dict[str, Any] = {
    "preset": "fast",
    "frame_budget": 40,
    "config": {"sensor": {"width": 64, "height": 36}, "views": {"max_candidates": 24}},
}


@pytest.fixture(scope="session")
def scene_files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """A room with a box in it, as any mesh, in Replica's layout and in Matterport3D's."""
    folder = tmp_path_factory.mktemp("scenes")
    room = trimesh.creation.box((4.0, 3.0, 2.5))
    room.invert()
    room.apply_translation((2.0, 1.5, 1.25))
    table = trimesh.creation.box((0.8, 0.6, 0.7))
    table.apply_translation((3.0, 1.0, 0.35))
    mesh = trimesh.util.concatenate([room.subdivide().subdivide(), table])
    mesh.visual.vertex_colors = (mesh.vertices / (4.0, 3.0, 2.5) * 255).astype("uint8")
    trimesh.Scene(mesh, metadata={"up": "z"}).export(folder / "room.glb")
    replica = folder / "replica_v1" / "room_0"
    replica.mkdir(parents=True)
    mesh.export(replica / "mesh.ply")
    matterport = folder / "mp3d" / "GdvgFV5R1Z5"
    matterport.mkdir(parents=True)
    mesh.export(matterport / "GdvgFV5R1Z5.glb")
    return {"Mesh": str(folder / "room.glb"), "Replica": str(replica), "Matterport3D": str(matterport)}


@pytest.fixture(params=ENV_IDS)
def env_id(request: pytest.FixtureRequest) -> str:
    """Each registered ID, in the form that works in every process."""
    return f"activestructure_gym:{request.param}"


@pytest.fixture
def options(env_id: str, scene_files: dict[str, str]) -> dict[str, Any]:
    """Constructor keywords that make ``env_id`` small."""
    return options_of(env_id, scene_files)


def options_of(env_id: str, scene_files: dict[str, str]) -> dict[str, Any]:
    """The same for any ID."""
    task = env_id.split("/")[1].split("-")[0]
    options = dict(SMALL)
    if task in scene_files:
        options["scene"] = scene_files[task]
    if task == "World":
        options["world"] = "simulated?scene=box&width=64&height=36"
    if task == "Apartment":
        options["rooms"] = 2
    return options


@pytest.fixture(scope="session")
def box_options() -> dict[str, Any]:
    """The smallest scene there is."""
    return {**SMALL, "scene": "box"}
