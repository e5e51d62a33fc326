"""Rooms and files that several worlds are tested with."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.worlds.recordings import record, recorded_poses
from tests.worlds.rooms import mjcf, room
from tests.worlds.splats import write_box


@pytest.fixture(scope="session")
def recorded_box(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of 24 frames in the box."""
    return record(tmp_path_factory.mktemp("recorded") / "box", recorded_poses())


@pytest.fixture(scope="session")
def splat_box(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The map of a run in the box."""
    return write_box(tmp_path_factory.mktemp("splat") / "box.ply")


@pytest.fixture(scope="session")
def mujoco_room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The room of boxes as an MJCF file; skips without MuJoCo, EGL or GL."""
    from activestructure_gym.errors import InputError
    from activestructure_gym.worlds import load_world

    pytest.importorskip("mujoco")
    path = tmp_path_factory.mktemp("mjcf") / "room.xml"
    path.write_text(mjcf(), encoding="utf-8")
    try:
        load_world(f"mujoco?model={path}").close()
    except InputError as error:
        if "EGL" not in str(error):
            raise
        pytest.skip(str(error))
    return path


@pytest.fixture(scope="session")
def mesh_room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The room of boxes as a mesh file; skips without EGL or GL."""
    import trimesh

    from activestructure_gym.sensors import renderer_status

    status = renderer_status()["pyrender"]
    if status != "works":
        pytest.skip(status)
    mesh = room().mesh
    path = tmp_path_factory.mktemp("mesh") / "room.ply"
    colours = (255 * mesh.colors).round().astype("uint8")
    trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_colors=colours, process=False).export(path)
    return path
