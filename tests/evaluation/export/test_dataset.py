"""Data sets for offline training are read back by readers that share no code with the writers."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from scipy.spatial.transform import Rotation

from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.export import PosedFrames, posed_frames, write_colmap, write_nerfstudio
from activestructure_gym.evaluation.export.dataset import seed_points
from activestructure_gym.evaluation.trajectories.axes import in_our_axes
from activestructure_gym.evaluation.trajectories.formats import find_file, read_poses
from activestructure_gym.geometry import PinholeCamera, invert_rigid

SIZE = (120, 80)  # another shape than the sensor's, so pixels are not square


@pytest.fixture(scope="module")
def colmap(run: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("colmap")
    write_colmap(posed_frames(run, size=SIZE), run.gaussians, folder)
    return folder


@pytest.fixture(scope="module")
def nerfstudio(run: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("nerfstudio")
    write_nerfstudio(posed_frames(run, size=SIZE), run.gaussians, folder)
    return folder


def keyframes(run: Run) -> np.ndarray:
    return run.trajectory["world_from_camera"][run.trajectory["keyframes"]]


def content(file: Path) -> list[str]:
    return [line for line in file.read_text().split("\n")[:-1] if not line.startswith("#")]


def test_the_poses_are_read_back_as_a_trajectory(run: Run, colmap: Path, nerfstudio: Path) -> None:
    for folder, kind, axes in ((colmap, "colmap", "opencv"), (nerfstudio, "nerfstudio", "opengl")):
        assert find_file(folder)[1] == kind
        np.testing.assert_allclose(in_our_axes(read_poses(folder), axes), keyframes(run), atol=1e-12)


def test_the_text_model_says_camera_poses_and_points(run: Run, colmap: Path) -> None:
    camera = posed_frames(run, size=SIZE).camera
    (line,) = content(colmap / "sparse/0/cameras.txt")
    assert line.split()[:4] == ["1", "PINHOLE", "120", "80"]
    assert [float(word) for word in line.split()[4:]] == [camera.fx, camera.fy, camera.cx, camera.cy]
    lines = content(colmap / "sparse/0/images.txt")
    assert len(lines) == 2 * len(keyframes(run)) and set(lines[1::2]) == {""}
    for number, (line, pose) in enumerate(zip(lines[::2], keyframes(run)), start=1):
        words = line.split()
        assert [words[0], words[8]] == [str(number), "1"] and (colmap / "images" / words[9]).is_file()
        w, x, y, z, *shift = map(float, words[1:8])
        rotation = Rotation.from_quat([x, y, z, w]).as_matrix()
        np.testing.assert_allclose(rotation.T, pose[:3, :3], atol=1e-12)
        np.testing.assert_allclose(-rotation.T @ shift, pose[:3, 3], atol=1e-12)
    points = np.array([line.split() for line in content(colmap / "sparse/0/points3D.txt")], float)
    means, colors = seed_points(run.gaussians)
    np.testing.assert_array_equal(points[:, 1:4].astype(np.float32), means)
    np.testing.assert_array_equal(points[:, 4:7], colors)
    assert len(means) == (run.gaussians.opacities >= 0.5).sum() > 100


def test_pycolmap_reads_the_model(run: Run, colmap: Path) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    model = pycolmap.Reconstruction(str(colmap / "sparse/0"))
    means, _ = seed_points(run.gaussians)
    assert (len(model.images), len(model.points3D)) == (len(keyframes(run)), len(means))
    for image, pose in zip((model.images[key] for key in sorted(model.images)), keyframes(run)):
        np.testing.assert_allclose(image.cam_from_world().matrix(), invert_rigid(pose)[:3], atol=1e-12)
    there = np.array([0.1, -0.2, 1.5])
    ours = posed_frames(run, size=SIZE).camera.project(there)
    np.testing.assert_allclose(model.cameras[1].img_from_cam(there), ours, atol=1e-9)


def test_the_depth_at_projected_means_is_theirs(run: Run, colmap: Path) -> None:
    (line,) = content(colmap / "sparse/0/cameras.txt")
    width, height, fx, fy, cx, cy = map(float, line.split()[2:])
    points = np.array([line.split()[1:4] for line in content(colmap / "sparse/0/points3D.txt")], float)
    off = list[np.ndarray]()
    for line in content(colmap / "sparse/0/images.txt")[::2]:
        w, x, y, z, *shift = map(float, line.split()[1:8])
        seen = Rotation.from_quat([x, y, z, w]).apply(points) + shift
        seen = seen[seen[:, 2] > 0.1]
        column, row = (fx * seen[:, 0] / seen[:, 2] + cx) // 1, (fy * seen[:, 1] / seen[:, 2] + cy) // 1
        inside = (column >= 0) & (row >= 0) & (column < width) & (row < height)
        depth = np.asarray(Image.open(colmap / "depth" / line.split()[9])).astype(float) * 0.001
        off.append(np.abs(depth[row[inside].astype(int), column[inside].astype(int)] - seen[inside, 2]))
    assert np.median(np.concatenate(off)) < 0.01 and len(np.concatenate(off)) > 100


def test_nerfstudio_gets_exactly_our_poses(run: Run, nerfstudio: Path) -> None:
    found = json.loads((nerfstudio / "transforms.json").read_text())
    camera = posed_frames(run, size=SIZE).camera
    assert (found["w"], found["h"]) == SIZE and found["depth_unit_scale_factor"] == 0.001
    assert [found[name] for name in ("fl_x", "fl_y", "cx", "cy")] == [camera.fx, camera.fy, camera.cx, camera.cy]
    poses = np.array([frame["transform_matrix"] for frame in found["frames"]])
    # OpenGL: y up and z backward, seen from the same camera.
    np.testing.assert_array_equal(poses * [1, -1, -1, 1], keyframes(run))
    names = [frame["file_path"] for frame in found["frames"]]
    assert names == sorted(names)  # nerfstudio sorts the frames by name
    for frame in found["frames"]:
        with Image.open(nerfstudio / frame["file_path"]) as picture:
            assert (picture.size, picture.mode) == (SIZE, "RGB")
        with Image.open(nerfstudio / frame["depth_file_path"]) as picture:
            assert (picture.size, picture.mode) == (SIZE, "I;16")
    cloud = trimesh.load(nerfstudio / found["ply_file_path"])
    means, colors = seed_points(run.gaussians)
    np.testing.assert_array_equal(cloud.vertices, means)
    np.testing.assert_array_equal(cloud.colors[:, :3], colors)


def test_the_pictures_show_what_was_mapped(run: Run, nerfstudio: Path) -> None:
    """Drawn at the sensor's size they are nearly the map's own renderings at the keyframes."""
    from activestructure_gym.splatting import cpu

    frames = posed_frames(run)
    off = [
        np.abs(cpu.render(run.gaussians.parameters, run.gaussians.count, frames.camera, pose).color - rgb / 255.0)
        for pose, (rgb, _) in zip(frames.world_from_camera, frames.images())
    ]
    assert np.median(np.stack(off)) < 0.05


def test_depth_is_in_millimetres_and_what_has_no_number_is_0(run: Run, tmp_path: Path) -> None:
    depth = np.array([[0.0, 1.2344, 1.2346, 65.535, 65.54, 900.0]], np.float32)
    camera = PinholeCamera(6, 1, 5.0, 6.0, 2.5, 0.25)
    images = [(np.zeros((1, 6, 3), np.uint8), depth)]
    frames = PosedFrames(camera, np.array([7]), np.eye(4)[None], lambda: iter(images))
    write_colmap(frames, run.gaussians, tmp_path)
    stored = np.asarray(Image.open(tmp_path / "depth/frame_000007.png"))
    assert stored.dtype == np.uint16 and stored.tolist() == [[0, 1234, 1235, 65535, 0, 0]]
    assert content(tmp_path / "sparse/0/cameras.txt") == ["1 PINHOLE 6 1 5.0 6.0 2.5 0.25"]
    assert "factor 0.001 to metres" in (tmp_path / "sparse/0/cameras.txt").read_text()
