from __future__ import annotations

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from activestructure_gym.errors import InputError
from activestructure_gym.scenes.loaders.replica import load_replica_scene
from activestructure_gym.scenes.loaders.sequence import load_sequence
from tests.scenes.test_traversal import brute_force


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
        far = (np.abs(depth - frame.depth) > 0.5 / sequence.depth_scale + 1e-5) & (frame.depth > 0)
        # The ray of a pixel may pass along an edge: brute force decides there.
        true = brute_force(
            scene.mesh.vertices, scene.mesh.faces, np.tile(frame.world_from_camera[:3, 3], (far.sum(), 1)),
            directions[far.ravel()],
        ).min(axis=1)  # fmt: skip
        assert far.sum() <= 1
        np.testing.assert_allclose(depth[far], true, rtol=1e-6)


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


def test_images_of_different_frames_are_no_pair(copy, redwood):
    (redwood / "color" / "00000.jpg").unlink()
    (redwood / "depth" / "00002.png").unlink()
    rows = (redwood / "trajectory.log").read_text().splitlines()
    (redwood / "trajectory.log").write_text("\n".join(rows[:10]))
    assert "the colour image '00001.jpg' and the depth image '00000.png' would be one frame" in _error(redwood)
    (copy / "results" / "frame000001.jpg").rename(copy / "results" / "frame000007.jpg")
    assert "the colour image 'frame000002.jpg' and the depth image 'depth000001.png'" in _error(copy)


def test_missing_parts(copy, tmp_path, monkeypatch):
    assert "no sequence folder" in _error(tmp_path / "gone")
    (copy.parent / "cam_params.json").rename(copy / "cam_params.json")
    assert len(load_sequence(copy)) == 3  # beside the trajectory is found as well
    own = json.loads((copy / "cam_params.json").read_text())
    (copy.parent / "cam_params.json").write_text(json.dumps({"camera": {**own["camera"], "fx": 99.0}}))
    assert load_sequence(copy).camera.fx == 20.0  # the nearest one
    (copy / "cam_params.json").unlink()
    monkeypatch.chdir(copy)
    assert load_sequence(".").camera.fx == 99.0 == load_sequence("results/..").camera.fx
    (copy.parent / "cam_params.json").unlink()
    assert "no cam_params.json" in _error(copy)
    (copy / "traj.txt").unlink()
    assert "no trajectory" in _error(copy)


@pytest.mark.parametrize(
    "line, said",
    [
        ("1 0 0", "line 2 .* has 16 numbers, and the first one has 3"),
        ("nothing " * 16, "a value that is not a number"),
        (" ".join(["nan"] * 16), "pose 1 .* not a rigid motion"),
        ("2 0 0 0 0 2 0 0 0 0 2 0 0 0 0 1", "pose 1 .* not a rigid motion"),
        ("1 0 0 0 0 1 0 0 0 0 -1 0 0 0 0 1", "pose 1 .* mirrors"),
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
    with pytest.raises(InputError, match="40 x 24 pixels, but the sequence's camera has 80 x 24"):
        load_sequence(copy).frame(0)


@pytest.fixture
def redwood(copy, tmp_path):
    """The same three frames in the layout of Redwood."""
    folder = tmp_path / "redwood"
    for name in ("color", "depth"):
        (folder / name).mkdir(parents=True)
    for n in range(3):
        shutil.copy(copy / "results" / f"frame{n:06d}.jpg", folder / "color" / f"{n:05d}.jpg")
        shutil.copy(copy / "results" / f"depth{n:06d}.png", folder / "depth" / f"{n:05d}.png")
    poses = load_sequence(copy).world_from_camera
    rows = ["\n".join(" ".join(map(repr, map(float, row))) for row in pose) for pose in poses]
    (folder / "trajectory.log").write_text("".join(f"{n} {n} {n + 1}\n{row}\n" for n, row in enumerate(rows)))
    camera = {"width": 40, "height": 24, "intrinsic_matrix": [20.0, 0, 0, 0, 20.0, 0, 19.5, 11.5, 1]}
    (folder / "camera_primesense.json").write_text(json.dumps(camera))
    return folder


def test_redwood_s_layout_gives_the_same_frames(copy, redwood):
    one, other = load_sequence(copy), load_sequence(redwood, depth_scale=6553.5)
    assert len(other) == 3 and other.camera == replace(one.camera, fx=20.0, fy=20.0, cx=20.0, cy=12.0)
    np.testing.assert_array_equal(one.world_from_camera, other.world_from_camera)
    for index in range(3):
        np.testing.assert_array_equal(one.frame(index).rgb, other.frame(index).rgb)
        np.testing.assert_array_equal(one.frame(index).depth, other.frame(index).depth)
    assert load_sequence(redwood).depth_scale == 1000.0
    assert load_sequence(redwood, intrinsics=(30, 31, 19.5, 11.5)).camera.fy == 31.0


def test_faults_of_redwood_s_layout(redwood):
    by_rows = {"width": 40, "height": 24, "intrinsic_matrix": [20.0, 0, 19.5, 0, 20.0, 11.5, 0, 0, 1]}
    (redwood / "camera_primesense.json").write_text(json.dumps(by_rows))
    assert "by columns, and this one is by rows" in _error(redwood)
    (redwood / "camera_primesense.json").unlink()
    assert "images are 40 x 24: give intrinsics=fx,fy,cx,cy" in _error(redwood)
    with pytest.raises(InputError, match="fx and fy above 0"):
        load_sequence(redwood, intrinsics=(0, 1, 2, 3))
    with pytest.raises(InputError, match="depth_scale is the depth image value per metre"):
        load_sequence(redwood, depth_scale=0.0)
    (redwood / "depth" / "00001.png").unlink()
    assert "3 poses, 3 colour and 2 depth images" in _error(redwood)
    (redwood / "trajectory.log").write_text("1 2 3\n")
    assert "is not a Redwood trajectory" in _error(redwood)


@pytest.fixture
def tum(redwood):
    """Colour at 0, 1 and 2 s; depth 10 ms later; poses every 0.5 s."""
    lists = {"rgb": ("color", "jpg", 0.0), "depth": ("depth", "png", 0.01)}
    for name, (folder, ending, later) in lists.items():
        lines = [f"{n + later} {folder}/{n:05d}.{ending}" for n in range(3)]
        (redwood / f"{name}.txt").write_text("# list\n" + "\n".join(lines))
    poses = load_sequence(redwood, intrinsics=(20, 20, 19.5, 11.5)).world_from_camera
    quaternions = Rotation.from_matrix(poses[:, :3, :3]).as_quat()
    rows = np.column_stack([np.arange(3), poses[:, :3, 3], quaternions])
    between = rows + np.array([0.5, 9, 9, 9, 0, 0, 0, 0])
    np.savetxt(redwood / "groundtruth.txt", np.stack([rows, between], axis=1).reshape(-1, 8))
    (redwood / "trajectory.log").rename(redwood / "poses.log")
    return redwood, poses


def test_tum_s_layout_is_joined_by_time_stamps(tum):
    folder, poses = tum
    sequence = load_sequence(folder)
    assert len(sequence) == 3 and sequence.depth_scale == 5000.0
    np.testing.assert_allclose(sequence.world_from_camera, poses, atol=1e-9)
    assert [file.name for file in sequence.depth_files] == ["00000.png", "00001.png", "00002.png"]
    (folder / "depth.txt").write_text("0.03 depth/00000.png\n1.019 depth/00001.png\n2.0 depth/00002.png\n")
    assert [file.name for file in load_sequence(folder).rgb_files] == ["00001.jpg", "00002.jpg"]  # 0.03 s is too far
    (folder / "associations.txt").write_text("0 color/00000.jpg 0.03 depth/00002.png\n")
    assert [file.name for file in load_sequence(folder).depth_files] == ["00002.png"]


def test_faults_of_tum_s_layout(tum):
    folder, _ = tum
    (folder / "rgb.txt").write_text("0.0 color/gone.jpg\n")
    assert "lists 1 images that are not in that folder, the first is 'color/gone.jpg'" in _error(folder)
    shutil.copy(folder / "color" / "00000.jpg", folder.parent / "elsewhere.jpg")
    for elsewhere in ("../elsewhere.jpg", folder.parent / "elsewhere.jpg", "color/" + 400 * "0"):
        (folder / "rgb.txt").write_text(f"0.0 {elsewhere}\n")
        assert "not in that folder" in _error(folder)
    for empty in ("depth", "rgb"):
        (folder / f"{empty}.txt").write_text("# nothing\n")
        assert "no colour image of" in _error(folder)
    (folder / "rgb.txt").write_text("77 color/00000.jpg\n")
    assert "no colour image of" in _error(folder)
    (folder / "rgb.txt").write_text("color/00000.jpg\n")
    assert "must have a time stamp and a file per line" in _error(folder)
    (folder / "rgb.txt").unlink()
    assert "there is no 'rgb.txt'" in _error(folder)
    (folder / "groundtruth.txt").write_text("0 0 0\n")
    assert "must have 8 numbers per line" in _error(folder)
