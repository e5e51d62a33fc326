from __future__ import annotations

import json
import shutil

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from activestructure_gym.errors import InputError
from activestructure_gym.scenes.loaders.replica import load_replica_scene
from activestructure_gym.scenes.loaders.sequence import load_sequence


def test_the_slam_camera_becomes_ours(replica_folder):
    sequence = load_sequence(replica_folder / "seq" / "room_a")
    camera = sequence.camera
    # cx = (W - 1) / 2 with integer pixel centres is W / 2 with centres at + 0.5.
    assert (camera.width, camera.height, camera.fx, camera.cx, camera.cy) == (40, 24, 20.0, 20.0, 12.0)
    assert len(sequence) == 3 and sequence.world_from_camera.shape == (3, 4, 4)


def test_backprojected_depth_lies_on_the_walls(replica_folder):
    sequence = load_sequence(replica_folder / "seq" / "room_a")
    for index in range(len(sequence)):
        frame = sequence.frame(index)
        assert frame.rgb.dtype == np.uint8 and frame.depth.dtype == np.float32
        assert np.abs(frame.rgb.reshape(-1, 3).astype(int) - [200, 60, 10]).max() <= 3  # RGB, not BGR; JPEG is lossy
        points = frame.world_points()
        assert len(points) == 40 * 24
        to_wall = np.minimum(np.abs(points), np.abs(points - [4.0, 3.0, 2.5])).min(axis=1)
        # Half a depth step along the ray (length up to 1.53 at the image corner).
        assert to_wall.max() < 0.5 / 6553.5 * 1.6 + 1e-6


def test_the_shared_fixture_s_depth_lies_on_its_mesh(shared):
    folder = shared / "scenes" / "replica_fixture"
    scene = load_replica_scene(folder / "room_fix", sequence=folder / "seq" / "room_fix")
    sequence = scene.evaluation_views
    rays = sequence.camera.rays().reshape(-1, 3)
    for index in range(len(sequence)):
        frame = sequence.frame(index)
        directions = rays @ frame.world_from_camera[:3, :3].T
        depth = scene.raycaster.cast(frame.world_from_camera[:3, 3], directions).distance.reshape(frame.depth.shape)
        assert np.abs(depth - frame.depth)[frame.depth > 0].max() < 0.5 / sequence.depth_scale + 1e-5


@pytest.fixture
def copy(replica_folder, tmp_path):
    shutil.copytree(replica_folder / "seq", tmp_path / "seq")
    return tmp_path / "seq" / "room_a"


def _error(path) -> str:
    with pytest.raises(InputError) as caught:
        load_sequence(path)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_images_are_read_when_asked_for(copy):
    (copy / "results" / "depth000001.png").write_bytes(b"broken")
    sequence = load_sequence(copy)
    assert sequence.frame(0).depth.max() > 0
    with pytest.raises(InputError, match="cannot be read as an image"):
        sequence.frame(1)


def test_numbers_of_poses_and_images_must_match(copy):
    (copy / "results" / "frame000002.jpg").unlink()
    assert "3 poses, 2 colour and 3 depth images" in _error(copy)


def test_missing_parts(copy, tmp_path):
    assert "no sequence folder" in _error(tmp_path / "gone")
    (copy.parent / "cam_params.json").rename(copy / "cam_params.json")
    assert len(load_sequence(copy)) == 3  # beside the trajectory is found as well
    (copy / "cam_params.json").unlink()
    assert "no cam_params.json" in _error(copy)
    (copy / "traj.txt").unlink()
    assert "no trajectory" in _error(copy)


@pytest.mark.parametrize(
    "line, said",
    [
        ("1 0 0", "16 numbers per line"),
        ("nothing here", "not a trajectory"),
        (" ".join(["nan"] * 16), "pose 1 .* no rigid motion"),
        ("2 0 0 0 0 2 0 0 0 0 2 0 0 0 0 1", "pose 1 .* no rigid motion"),
        ("1 0 0 0 0 1 0 0 0 0 -1 0 0 0 0 1", "pose 1 .* no rigid motion"),  # a mirror
    ],
)
def test_trajectories_that_are_none(copy, line, said):
    text = (copy / "traj.txt").read_text().splitlines()
    (copy / "traj.txt").write_text("\n".join([line, *text[1:]]))
    with pytest.raises(InputError, match=said):
        load_sequence(copy)


def test_poses_with_four_digits_are_rotations_and_exact_ones_stay(copy):
    exact = load_sequence(copy).world_from_camera
    given = np.loadtxt(copy / "traj.txt").reshape(-1, 4, 4)
    assert exact.tobytes() == given.tobytes()
    turn = Rotation.from_euler("xyz", [0.1, 0.7, 0.3]).as_matrix()
    given[:, :3, :3] = given[:, :3, :3] @ turn
    np.savetxt(copy / "traj.txt", given.reshape(-1, 16), fmt="%.4f")
    rotations = load_sequence(copy).world_from_camera[:, :3, :3]
    np.testing.assert_allclose(rotations, given[:, :3, :3], atol=2e-4)
    np.testing.assert_allclose(rotations @ rotations.transpose(0, 2, 1), np.tile(np.eye(3), (3, 1, 1)), atol=1e-12)


def test_camera_files_that_are_none(copy):
    file = copy.parent / "cam_params.json"
    given = json.loads(file.read_text())
    for change, said in (({"fx": 0}, "fx=0"), ({"scale": 0}, "above 0"), ({"w": None}, "is not a camera")):
        file.write_text(json.dumps({"camera": {**given["camera"], **change}}))
        assert said in _error(copy)
    file.write_text(json.dumps({"camera": {**given["camera"], "w": 80}}))
    with pytest.raises(InputError, match="40 x 24 pixels, but cam_params.json says 80 x 24"):
        load_sequence(copy).frame(0)
