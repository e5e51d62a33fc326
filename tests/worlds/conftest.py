"""Rooms and files that several worlds are tested with."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.worlds.rooms import mjcf


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
