from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.scenes import load_scene
from activestructure_gym.scenes.loaders.scannet import is_scannet, is_scannetpp

# A quarter turn about z that moves the box's corner (1, 2, 0) to the origin: (x, y) -> (-y + 5, x - 1).
QUARTER = "0 -1 0 5 1 0 0 -1 0 0 1 0 0 0 0 1"


@pytest.fixture
def box_at(make_box):
    """Writes a box from (1, 2, 0) to (5, 5, 2.5) as PLY."""
    import trimesh

    def write(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        trimesh.Trimesh(*make_box((1, 2, 0), (5, 5, 2.5)), process=False).export(path)
        return path

    return write


@pytest.fixture
def scan(tmp_path, box_at):
    folder = tmp_path / "scans" / "scene0000_00"
    box_at(folder / "scene0000_00_vh_clean_2.ply")
    (folder / "scene0000_00.txt").write_text(
        f"appVersionId = 1\naxisAlignment = {QUARTER} \ncolorHeight = 968\nsceneType = Living room\n"
    )
    return folder


@pytest.mark.parametrize("form", ["", "scene0000_00_vh_clean_2.ply"])
@pytest.mark.parametrize("prefix", ["", "scannet:"])
def test_a_scan_is_turned_along_the_axes(scan, form, prefix):
    scene = load_scene(f"{prefix}{scan / form}")
    assert scene.name == "scene0000_00" and is_scannet(scan / form)
    np.testing.assert_allclose(scene.bounds, [[0, 0, 0], [3, 4, 2.5]], atol=1e-6)


def test_a_scan_without_an_alignment_stays_as_it_is(scan):
    (scan / "scene0000_00.txt").write_text("colorHeight = 968\n")
    np.testing.assert_allclose(load_scene(str(scan)).bounds, [[1, 2, 0], [5, 5, 2.5]], atol=1e-6)


@pytest.mark.parametrize(
    "said",
    [
        "", "1 0 0", "x", QUARTER.replace("5", "nan"), QUARTER.replace("5", "1e39"), QUARTER.replace("-1", "1", 1),
        QUARTER.replace("-1", "-2", 1),
    ],
)  # fmt: skip
def test_an_alignment_that_is_no_motion_is_refused(scan, said):
    (scan / "scene0000_00.txt").write_text(f"axisAlignment = {said}\n")
    with pytest.raises(InputError, match="axisAlignment must be 16 numbers"):
        load_scene(str(scan))


def test_what_is_missing_is_named(scan):
    with pytest.raises(InputError, match="a folder of scenes; give one of them"):
        load_scene(str(scan.parent))
    with pytest.raises(InputError, match="is not a ScanNet scan: expected a folder"):
        load_scene(f"scannet:{scan.parent}")
    (scan / "scene0000_00.txt").write_bytes(b"\xff\xfe")
    with pytest.raises(InputError, match="not the text file of a ScanNet scan"):
        load_scene(str(scan))
    (scan / "scene0000_00.txt").unlink()
    assert not is_scannet(scan)
    with pytest.raises(InputError, match="text file of a ScanNet scan with its axisAlignment"):
        load_scene(f"scannet:{scan}")


@pytest.mark.parametrize("form", ["", "scans/mesh_aligned_0.05.ply"])
@pytest.mark.parametrize("prefix", ["", "scannetpp:"])
def test_a_scene_of_scannetpp_is_named_by_its_folder(tmp_path, box_at, form, prefix):
    folder = tmp_path / "data" / "0a5c013435"
    box_at(folder / "scans" / "mesh_aligned_0.05.ply")
    scene = load_scene(f"{prefix}{folder / form}")
    assert scene.name == "0a5c013435" and is_scannetpp(folder / form)
    np.testing.assert_allclose(scene.bounds, [[1, 2, 0], [5, 5, 2.5]], atol=1e-6)


def test_a_folder_without_the_mesh_of_scannetpp_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"is not a ScanNet\+\+ scene: expected a folder"):
        load_scene(f"scannetpp:{tmp_path}")
