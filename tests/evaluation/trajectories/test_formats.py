"""Files of poses, written by hand as each program writes them."""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import numpy as np
import pytest

from activestructure_gym.errors import InputError, InputWarning
from activestructure_gym.evaluation.trajectories import formats
from activestructure_gym.evaluation.trajectories.formats import find_file, read_poses
from activestructure_gym.scenes.loaders import pose_text

# A quarter turn about z, then (1, 2, 3).
TURNED = np.array([[0.0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]])
HALF = np.sqrt(0.5)
LINES = {
    "tum": f"# timestamp tx ty tz qx qy qz qw\n0 0 0 0 0 0 0 1\n0.1 1 2 3 0 0 {HALF} {HALF}\n",
    "nice_slam": "1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1\n0 -1 0 1 1 0 0 2 0 0 1 3 0 0 0 1\n",
    "kitti": "1 0 0 0 0 1 0 0 0 0 1 0\n0 -1 0 1 1 0 0 2 0 0 1 3\n",
    "redwood": "0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n1 1 2\n0 -1 0 1\n1 0 0 2\n0 0 1 3\n0 0 0 1\n",
    "habitat": '[{"position": [0, 0, 0], "rotation": [0, 0, 0, 1]},'
    f' {{"position": [1, 2, 3], "rotation": [0, 0, {HALF}, {HALF}]}}]',
}


def write(folder: Path, kind: str, text: str = "") -> Path:
    path = folder / f"poses.{ {'habitat': 'json', 'redwood': 'log'}.get(kind, 'txt') }"
    path.write_text(text or LINES[kind])
    return path


@pytest.mark.parametrize("kind", LINES)
def test_every_format_says_the_same_poses_and_is_known_by_its_look(kind: str, tmp_path: Path) -> None:
    path = write(tmp_path, kind)
    for asked in (kind, "auto"):
        poses = read_poses(path, asked)
        np.testing.assert_allclose(poses, [np.eye(4), TURNED], atol=1e-15)
    assert find_file(path)[1] == kind


def test_an_npz_is_read_to_the_last_bit(tmp_path: Path) -> None:
    poses = np.stack([np.eye(4), TURNED])
    poses[1, 0, 3] = 0.1 + 0.2
    np.savez(tmp_path / "trajectory.npz", world_from_camera=poses)
    assert read_poses(tmp_path / "trajectory.npz").tobytes() == poses.tobytes()
    assert read_poses(tmp_path).tobytes() == poses.tobytes(), "a folder that has one"


def test_a_rotation_with_three_digits_is_taken_as_the_nearest_one(tmp_path: Path) -> None:
    path = write(tmp_path, "kitti", "0.936 -0.275 0.218 1 0.29 0.956 -0.037 2 -0.199 0.098 0.975 3\n")
    rotation = read_poses(path)[0, :3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(rotation[0], [0.936, -0.275, 0.218], atol=1e-3)


@pytest.mark.parametrize(("kind", "name"), [("nice_slam", "traj.txt"), ("replica", "traj_w_c.txt")])
def test_a_folder_of_a_sequence_has_its_file(kind: str, name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(LINES["nice_slam"])
    assert len(read_poses(tmp_path, kind)) == len(read_poses(tmp_path)) == 2


@pytest.mark.parametrize(
    ("kind", "text", "said"),
    [
        ("auto", "1 2 3\n", r"expected 8 numbers per line \(tum\), 12 \(kitti\) or 16"),
        ("kitti", LINES["tum"], "8 numbers per line, and kitti has 12"),
        ("tum", "0 0 0 0 0 0 0 1\n0 1 2\n", "line 2 .* has 3 numbers"),
        ("tum", "0 0 0 0 0 0 0 2\n", "quaternion of length 2"),
        ("tum", "0 0 0 0 0 0 1e308 1\n", "quaternion of length inf"),
        ("tum", "0 0 0 x 0 0 0 1\n", "not a trajectory of numbers"),
        ("nice_slam", "1 0 0 0 0 1 0 0 0 0 -1 0 0 0 0 1\n", "pose 1 .* mirrors: its axes are left-handed"),
        ("nice_slam", "2 0 0 0 0 2 0 0 0 0 2 0 0 0 0 1\n", "pose 1 .* is no rigid motion"),
        ("nice_slam", "nan 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1\n", "pose 1 .* is no rigid motion"),
        ("nice_slam", "1 0 0 2e6 0 1 0 0 0 0 1 0 0 0 0 1\n", r"pose 1 .* stands 2e\+06 m away"),
        ("kitti", "1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 0 0 1 0 -1e300 0 0 1 0\n", "pose 2 .* stands 1e"),
        ("tum", "2 0 0 0 0 0 0 1\n1 1 0 0 0 0 0 1\n", "pose 2 .* has an earlier time stamp"),
        ("tum", "0 0 0 0 0 0 0 1\nnan 1 0 0 0 0 0 1\n", "pose 2 .* has an earlier time stamp"),
        ("tum", "# nothing\n", "holds no pose"),
        ("redwood", LINES["nice_slam"], "a line of 3 numbers and 4 lines of 4 numbers"),
        ("redwood", "# nothing\n", "not a Redwood trajectory"),
        ("redwood", LINES["redwood"].replace("-1", "x"), "not a trajectory of numbers"),
        ("habitat", '[{"position": [0, 0]}]', "no trajectory of Habitat"),
        ("habitat", '[{"position": [0, 0, 0], "rotation": [0, 0, 0, 0.5]}]', "no unit quaternion"),
        ("colmap", "", "unknown trajectory format 'colmap'"),
    ],
)
def test_what_is_wrong_is_said_in_a_sentence(kind: str, text: str, said: str, tmp_path: Path) -> None:
    path = write(tmp_path, kind, text or "0")
    with warnings.catch_warnings(action="error"), pytest.raises(InputError, match=said):
        read_poses(path, kind)


def test_poses_of_one_time_stamp_are_read_as_they_stand(tmp_path: Path) -> None:
    path = write(tmp_path, "tum", "0 0 0 0 0 0 0 1\n0 1 0 0 0 0 0 1\n")
    assert read_poses(path)[:, 0, 3].tolist() == [0.0, 1.0]


def test_a_file_that_is_not_there_or_not_an_npz_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no trajectory"):
        read_poses(tmp_path / "none.txt")
    with pytest.raises(InputError, match="has no trajectory"):
        read_poses(tmp_path)
    (tmp_path / "poses.npz").write_bytes(b"no zip")
    with pytest.raises(InputError, match="cannot be read as a trajectory.npz"):
        read_poses(tmp_path / "poses.npz")
    np.savez(tmp_path / "poses.npz", poses=np.eye(4))
    with pytest.raises(InputError, match="holds no array world_from_camera"):
        read_poses(tmp_path / "poses.npz")


@pytest.fixture
def scan(tmp_path: Path) -> Path:
    """A ScanNet scan whose walls stand along the axes after a quarter turn, with its second pose lost."""
    folder = tmp_path / "scene0001_00"
    (folder / "pose").mkdir(parents=True)
    (folder / "scene0001_00.txt").write_text("axisAlignment = 0 -1 0 1 1 0 0 2 0 0 1 3 0 0 0 1\n")
    (folder / "pose" / "0.txt").write_text("1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n")
    (folder / "pose" / "1.txt").write_text("-inf -inf -inf -inf\n" * 4)
    (folder / "pose" / "10.txt").write_text("1 0 0 4\n0 1 0 0\n0 0 1 0\n0 0 0 1\n")
    (folder / "pose" / "9.txt").write_text("1 0 0 3\n0 1 0 0\n0 0 1 0\n0 0 0 1\n")
    return folder


@pytest.mark.parametrize("place", ["", "pose"])
def test_a_scan_s_poses_are_turned_with_its_mesh_and_lost_ones_are_counted(scan: Path, place: str) -> None:
    with pytest.warns(InputWarning, match="1 of 4 poses of .* are not known"):
        poses = read_poses(scan / place)
    # In the order of their numbers: 3 and 4 m along x, which the turn makes y.
    np.testing.assert_allclose(poses[:, :3, 3], [[1, 2, 3], [1, 5, 3], [1, 6, 3]])
    np.testing.assert_allclose(poses[0], TURNED)
    assert find_file(scan) == (scan / "pose", "scannet")


def test_what_is_no_folder_of_a_scan_s_poses(scan: Path) -> None:
    with pytest.raises(InputError, match="give the scan's folder"):
        read_poses(scan / "pose" / "0.txt", "scannet")
    (scan / "pose" / "9.txt").write_text("1 2 3")
    with pytest.raises(InputError, match="must hold 16 numbers, a pose row by row, got 3"):
        read_poses(scan)
    for file in (scan / "pose").iterdir():
        file.write_text("nan nan nan nan\n" * 4)
    with pytest.raises(InputError, match="none of the 4 poses"):
        read_poses(scan)
    for file in list((scan / "pose").iterdir()):
        file.unlink()
    with pytest.raises(InputError, match="holds no pose"):
        read_poses(scan)


def test_recordings_of_scannetpp(tmp_path: Path) -> None:
    (tmp_path / "iphone").mkdir()
    file = tmp_path / "iphone" / "pose_intrinsic_imu.json"
    lost = np.full((4, 4), np.inf).tolist()
    frames = {"frame_000010": TURNED.tolist(), "frame_000000": np.eye(4).tolist(), "frame_000020": lost}
    file.write_text(json.dumps({name: {"pose": lost, "aligned_pose": pose} for name, pose in frames.items()}))
    for place in (tmp_path, file):
        with pytest.warns(InputWarning, match="1 of 3 poses"):
            np.testing.assert_allclose(read_poses(place), [np.eye(4), TURNED])
    for broken in ('{"frame_0": {"pose": []}}', "{}", '{"frame_0": {"aligned_pose": [[1, 0], [0, 1]]}}', "[]"):
        file.write_text(broken)
        with pytest.raises(InputError, match="is not the poses of a ScanNet"):
            read_poses(tmp_path)


def test_no_more_lines_are_read_than_poses_may_be(tmp_path, monkeypatch):
    for module in (formats, pose_text):
        monkeypatch.setattr(module, "MAX_POSES", 3)
    (tmp_path / "long.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n" * 4 + "1 0\n" * 50)
    with pytest.raises(InputError, match="holds 4 poses, from 1 to 3 are read"):
        read_poses(tmp_path / "long.txt")
