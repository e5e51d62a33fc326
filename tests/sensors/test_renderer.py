import importlib.util
import subprocess
import sys

import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.sensors import Renderer, make_renderer, renderer_status
from activestructure_gym.sensors.raycast import RaycastRenderer


def test_auto_is_ray_casting(box_room):
    renderer: Renderer = make_renderer("auto", box_room)
    assert isinstance(renderer, RaycastRenderer) and renderer.name == "raycast"


def test_unknown_name_is_one_clear_sentence(box_room):
    with pytest.raises(InputError, match="unknown sensor backend 'raycats'; did you mean 'raycast'"):
        make_renderer("raycats", box_room)


def test_status_names_what_hangs(monkeypatch):
    def hang(command, **options):
        raise subprocess.TimeoutExpired(command, options["timeout"])

    monkeypatch.setattr(subprocess, "run", hang)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert renderer_status() == {
        "raycast": "works",
        "warp": "package warp-lang is missing: pip install 'activestructure-gym[warp]'",
        "pyrender": "starting OpenGL took more than 60 s",
    }


def test_status_of_every_renderer(status):
    assert status.keys() == {"raycast", "warp", "pyrender"}
    assert status["raycast"] == "works"
    assert status["pyrender"] == "works" or "libegl1 libgl1" in status["pyrender"]


def test_importing_the_room_loads_no_heavy_library():
    heavy = "{'numba', 'OpenGL', 'pyrender', 'trimesh', 'torch', 'cv2', 'matplotlib'}"
    code = f"import sys, activestructure_gym.sensors; print(sorted({heavy} & set(sys.modules)))"
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert answer.stdout.strip() == "[]"
