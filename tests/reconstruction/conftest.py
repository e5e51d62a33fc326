import pytest

from activestructure_gym.scenes import Scene, load_scene


@pytest.fixture(scope="module")
def box() -> Scene:
    return load_scene("box")
