"""The meshes of the tests of scenes, whose truth is asked for here."""

from tests.scenes.conftest import (  # noqa: F401
    furnished_room,
    join,
    make_box,
    make_scene,
    own_cache,
)
