from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.scenes import load_scene
from activestructure_gym.scenes.loaders.matterport3d import is_matterport3d, load_matterport3d_scene


@pytest.fixture
def house(tmp_path, gltf, make_box):
    """mp3d/17DRP5sb8fy/ as the Habitat download has it, with a box for a house."""
    folder = tmp_path / "mp3d" / "17DRP5sb8fy"
    folder.mkdir(parents=True)
    gltf.triangle_mesh(*make_box((-3, -2, 0), (3, 2, 2.6)))
    gltf.write(folder / "17DRP5sb8fy.glb")
    for name in (".house", ".navmesh", "_semantic.ply"):
        (folder / f"17DRP5sb8fy{name}").write_bytes(b"not read")
    return folder


@pytest.mark.parametrize("form", ["", "17DRP5sb8fy.glb"])
def test_folder_and_file_are_the_same_scene_with_z_up(house, form):
    scene = load_matterport3d_scene(house / form)
    assert scene.name == "17DRP5sb8fy" and is_matterport3d(house / form)
    np.testing.assert_allclose(scene.bounds, [[-3, -2, 0], [3, 2, 2.6]], atol=1e-6)


def test_the_folder_one_stands_in(house, monkeypatch):
    monkeypatch.chdir(house)
    for form in (".", "./", "matterport3d:.", "../17DRP5sb8fy"):
        assert load_scene(form).name == "17DRP5sb8fy"


def test_a_folder_with_another_name_and_one_mesh(house):
    renamed = house.rename(house.with_name("my_house"))
    assert load_matterport3d_scene(renamed).name == "17DRP5sb8fy"
    assert not is_matterport3d(renamed)


def test_a_folder_of_that_shape_is_no_matterport_scene(tmp_path, gltf, make_box):
    """house/house.glb is anybody's; glTF's rule holds for it, and the option `up` is free."""
    (tmp_path / "house").mkdir()
    vertices, faces = make_box((-3, -2, 0), (3, 2, 2.6))
    gltf.triangle_mesh(vertices[:, [0, 2, 1]] * (1, 1, -1), faces)
    mesh_file = gltf.write(tmp_path / "house" / "house.glb")
    mesh_file.with_suffix(".navmesh").write_bytes(b"of any Habitat scene")
    for path in (mesh_file, mesh_file.parent):
        assert not is_matterport3d(path)
        assert load_scene(f"{path}?up=y").bounds[1].tolist() == pytest.approx([3, 2, 2.6])
        assert load_scene(f"{path}?up=-y").bounds[1].tolist() == pytest.approx([3, 2, 0])


@pytest.mark.parametrize("name", [".house", "_semantic.ply"])
def test_one_file_of_the_dataset_is_enough(house, name):
    for other in {".house", ".navmesh", "_semantic.ply"} - {name}:
        (house / f"17DRP5sb8fy{other}").unlink()
    assert is_matterport3d(house) and is_matterport3d(house / "17DRP5sb8fy.glb")


def test_what_is_no_matterport_scene(tmp_path, house):
    with pytest.raises(InputError, match=r"expected 'mp3d.glb' in it, found no .glb file"):
        load_matterport3d_scene(house.parent)
    with pytest.raises(InputError, match="not a Matterport3D mesh"):
        load_matterport3d_scene(house / "17DRP5sb8fy_semantic.ply")
    with pytest.raises(InputError, match="there is no mesh file"):
        load_matterport3d_scene(tmp_path / "gone.glb")


def test_basis_textures_are_refused(tmp_path, gltf, make_box):
    """HM3D's .basis.glb: the usual file that people try here."""
    gltf.triangle_mesh(*make_box((0, 0, 0), (4, 3, 2.5)))
    gltf.header["extensionsRequired"] = ["KHR_texture_basisu"]
    with pytest.raises(InputError, match="KTX2"):
        load_matterport3d_scene(gltf.write(tmp_path / "TEEsavR23oF.basis.glb"))
