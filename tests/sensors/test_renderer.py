import dataclasses
import importlib.util
import subprocess
import sys

import numpy as np
import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.sensors import Renderer, make_renderer, renderer_status
from activestructure_gym.sensors.raycast import RaycastRenderer


def test_auto_is_ray_casting(box_room):
    renderer: Renderer = make_renderer("auto", box_room)
    assert isinstance(renderer, RaycastRenderer) and renderer.name == "raycast"


def test_unknown_name_is_one_clear_sentence(box_room):
    with pytest.raises(InputError, match="unknown sensor backend 'raycats'; did you mean 'raycast'"):
        make_renderer("raycats", box_room)


def test_status_names_the_tracer_and_what_hangs(monkeypatch):
    def hang(command, **options):
        raise subprocess.TimeoutExpired(command, options["timeout"])

    monkeypatch.setenv("ASG_RAYCASTER", "numba")
    monkeypatch.setattr(subprocess, "run", hang)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert renderer_status() == {
        "raycast": "works, with numba (ASG_RAYCASTER=numba)",
        "warp": "package warp-lang is missing: pip install 'activestructure-gym[warp]'",
        "pyrender": "starting OpenGL took more than 60 s",
    }


def test_status_of_every_renderer(status):
    assert status.keys() == {"raycast", "warp", "pyrender"}
    assert status["raycast"].startswith("works, with ")
    assert status["pyrender"] == "works" or "libegl1 libgl1" in status["pyrender"]


def test_importing_the_room_loads_no_heavy_library():
    heavy = "{'numba', 'OpenGL', 'pyrender', 'trimesh', 'torch', 'cv2', 'matplotlib'}"
    code = f"import sys, activestructure_gym.sensors; print(sorted({heavy} & set(sys.modules)))"
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert answer.stdout.strip() == "[]"


def test_images_of_both_tracers_are_the_same(cluttered_room, monkeypatch):
    pytest.importorskip("embreex")
    pose = look_along(cluttered_room.bounds.mean(axis=0), np.array([1.0, 0.2, -0.1]))
    images = []
    for tracer in ("numba", "embree"):
        monkeypatch.setenv("ASG_RAYCASTER", tracer)
        scene = dataclasses.replace(cluttered_room)  # without a ray caster
        images.append(RaycastRenderer(scene, threads=1).render(PinholeCamera.from_size(160, 90, 90.0), pose))
    (colors, depth), (expected_colors, expected) = images
    assert expected.max() > 1.0
    np.testing.assert_allclose(depth, expected, rtol=1e-5)
    assert (np.abs(colors.astype(int) - expected_colors) > 1).any(axis=-1).mean() < 0.001
