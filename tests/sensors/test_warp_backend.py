"""Warp's ray caster against ours, on Warp's CPU device or on the first CUDA device."""

import gc
import pickle
import sys

import numpy as np
import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.scenes.scene import Scene
from activestructure_gym.sensors import make_renderer
from activestructure_gym.sensors.raycast import RaycastRenderer, _pixel_rays

CAMERA = PinholeCamera(96, 54, 47.0, 49.0, 50.0, 25.0)


def test_without_the_package_one_sentence_says_what_to_install(box_room, monkeypatch):
    monkeypatch.setitem(sys.modules, "warp", None)
    monkeypatch.delitem(sys.modules, "activestructure_gym.sensors.warp_backend", raising=False)
    with pytest.raises(InputError, match=r"'warp' cannot run here: .* pip install 'activestructure-gym\[warp\]'"):
        make_renderer("warp", box_room)


@pytest.fixture(scope="module")
def warp():
    pytest.importorskip("warp")
    return pytest.importorskip("activestructure_gym.sensors.warp_backend")


@pytest.mark.parametrize("supersample", [1, 2, 3])
def test_hits_are_those_of_our_kernels(supersample, warp, cluttered_room, room_poses):
    rays = supersample**2 + 1 - supersample % 2
    same = []
    for pose in room_poses:
        directions = np.empty((CAMERA.width * CAMERA.height * rays, 3), np.float32)
        _pixel_rays(pose[:3, :3].copy(), CAMERA.lens, CAMERA.width, 0, CAMERA.height, supersample, directions)
        expected = cluttered_room.raycaster.cast(pose[:3, 3].astype(np.float32), directions)
        found = warp.WarpRenderer(cluttered_room).first_hits(CAMERA, pose, supersample, rays)
        assert np.array_equal(found.face < 0, expected.face < 0)
        hit = expected.face >= 0
        assert np.abs(found.distance - expected.distance)[hit].max() < 5e-6  # metres
        same.append(found.face == expected.face)
        for name in ("u", "v"):
            difference = np.abs(getattr(found, name) - getattr(expected, name))[same[-1] & hit]
            assert np.quantile(difference, 0.999) < 1e-4, name
    assert np.mean(same) > 0.999  # the others go through an edge, which belongs to two triangles


def test_pictures_are_those_of_ray_casting(warp, cluttered_room, room_poses):
    one, other = RaycastRenderer(cluttered_room, threads=1), make_renderer("warp", cluttered_room)
    assert other.name == "warp"
    for pose in room_poses[:3]:
        (rgb, depth), (color, shown) = (each.render(CAMERA, pose) for each in (one, other))
        assert color.dtype == np.uint8 and shown.dtype == np.float32 and shown.shape == depth.shape
        assert np.abs(shown - depth).max() < 5e-6
        assert (np.abs(color.astype(int) - rgb) > 1).any(axis=-1).mean() < 1e-3
    copy = pickle.loads(pickle.dumps(other))
    assert np.array_equal(copy.render(CAMERA, pose)[1], shown)
    other.close()
    other.close()


def test_a_ray_that_hits_nothing_is_black_and_has_no_depth(warp, make_quad, merge):
    quad = make_quad([[0, 0, 2], [1, 0, 2], [1, 1, 2], [0, 1, 2]], [0.5, 0.5, 0.5], np.zeros((4, 2)), -1)
    scene = Scene("quad", merge([quad]), "tests")
    rgb, depth = warp.WarpRenderer(scene).render(PinholeCamera(4, 4, 2.0, 2.0, 2.0, 2.0), np.eye(4), supersample=1)
    assert np.array_equal(depth, [[0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 2, 0], [0, 0, 0, 0]])
    assert rgb[2, 2].tolist() == [128, 128, 128] and rgb.sum() == 3 * 128
    with pytest.raises(ValueError, match="supersample must be at least 1, got 0"):
        warp.WarpRenderer(scene).render(CAMERA, np.eye(4), supersample=0)


def test_the_mesh_on_the_device_goes_with_its_scene(warp, box_room, room_poses):
    scene = Scene("copy", box_room.mesh, "tests")
    warp.WarpRenderer(scene).render(CAMERA, room_poses[0])
    assert id(scene) in warp._meshes
    key = id(scene)
    del scene
    gc.collect()
    assert key not in warp._meshes
