"""Scans of HM3D and Gibson, in folders as they are downloaded."""

import numpy as np
import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.scenes import load_scene
from activestructure_gym.scenes.loaders.hm3d import is_hm3d, load_gibson_scene, load_hm3d_scene

BOUNDS = [[-3, -2, 0], [3, 2, 2.6]]


@pytest.fixture
def house(gltf, make_box):
    gltf.triangle_mesh(*make_box(*map(tuple, BOUNDS)))
    return gltf


@pytest.fixture
def scan(house, tmp_path):
    folder = tmp_path / "val" / "00800-TEEsavR23oF"
    folder.mkdir(parents=True)
    house.write(folder / "TEEsavR23oF.glb")
    (folder / "TEEsavR23oF.basis.glb").write_bytes(b"not read")
    (folder / "TEEsavR23oF.basis.navmesh").write_bytes(b"not read")
    return folder


@pytest.mark.parametrize("form", ["", "TEEsavR23oF.glb", "TEEsavR23oF.basis.glb"])
def test_folder_and_mesh_of_hm3d_are_one_scene_with_z_up(scan, form):
    scene = load_hm3d_scene(scan / form)
    assert scene.name == "TEEsavR23oF"
    np.testing.assert_allclose(scene.bounds, BOUNDS, atol=1e-6)


def test_a_bare_folder_of_hm3d_is_known(scan):
    assert is_hm3d(scan) and load_scene(str(scan)).name == "TEEsavR23oF"
    assert not is_hm3d(scan.parent) and not is_hm3d(scan.rename(scan.with_name("somewhere")))
    assert load_hm3d_scene(scan.with_name("somewhere")).name == "TEEsavR23oF"  # the one mesh in it


def test_the_mesh_of_hm3d_and_the_folder_one_stands_in_are_known(scan, monkeypatch):
    for name in ("TEEsavR23oF.glb", "TEEsavR23oF.basis.glb"):
        np.testing.assert_allclose(load_scene(str(scan / name)).bounds, BOUNDS, atol=1e-6)
    assert not is_hm3d(scan / "TEEsavR23oF.basis.navmesh") and not is_hm3d(scan / "TEEsavR23oF.semantic.glb")
    monkeypatch.chdir(scan)
    for form in (".", "./", "TEEsavR23oF.glb", "../00800-TEEsavR23oF"):
        np.testing.assert_allclose(load_scene(form).bounds, BOUNDS, atol=1e-6)


@pytest.mark.parametrize("form", ["", "TEEsavR23oF.glb", "TEEsavR23oF.basis.glb"])
def test_the_copy_for_habitat_alone_is_refused_with_what_to_get(scan, form):
    (scan / "TEEsavR23oF.glb").unlink()
    with pytest.raises(InputError, match="no file 'TEEsavR23oF.glb', only its copy for Habitat.*`glb` archive"):
        load_hm3d_scene(scan / form)


def test_what_is_no_scan_of_hm3d_is_refused(tmp_path):
    with pytest.raises(InputError, match="not a folder of an HM3D scan.*found 0"):
        load_hm3d_scene(tmp_path)
    (tmp_path / "house.obj").write_text("")
    with pytest.raises(InputError, match="not an HM3D mesh"):
        load_hm3d_scene(tmp_path / "house.obj")
    with pytest.raises(InputError, match="not an HM3D scan that can be read"):
        load_scene(f"hm3d:{tmp_path / '00001-nothing'}")


def test_gibson_by_name_file_and_folder(house, tmp_path):
    house.write(tmp_path / "Adrian.glb")
    (tmp_path / "Adrian.navmesh").write_bytes(b"not read")
    (tmp_path / "Bolton").mkdir()
    house.write(tmp_path / "Bolton" / "Bolton.glb")
    for form, name in (("Adrian", "Adrian"), ("Adrian.glb", "Adrian"), ("Bolton", "Bolton")):
        scene = load_scene(f"gibson:{tmp_path / form}")
        assert scene.name == name
        np.testing.assert_allclose(scene.bounds, BOUNDS, atol=1e-6)
    with pytest.raises(InputError, match="no Gibson scan .*gibson_habitat.zip"):
        load_gibson_scene(tmp_path / "Collierville")
