"""Files of poses, written by hand as each program writes them."""

from __future__ import annotations

import json
import struct
import warnings
from pathlib import Path

import numpy as np
import pytest

from activestructure_gym.errors import InputError, InputWarning
from activestructure_gym.evaluation.trajectories import formats
from activestructure_gym.evaluation.trajectories.alignment import matched
from activestructure_gym.evaluation.trajectories.formats import find_file, read_poses, read_recorded
from activestructure_gym.scenes.loaders import pose_text

# A quarter turn about z, then (1, 2, 3).
TURNED = np.array([[0.0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]])
HALF = np.sqrt(0.5)
LINES = {
    "nerfstudio": json.dumps(
        {
            "camera_model": "OPENCV",
            "frames": [
                {"file_path": "images/frame_10.jpg", "transform_matrix": TURNED.tolist()},
                {"file_path": "images/frame_2.jpg", "transform_matrix": np.eye(4).tolist()},
            ],
        }
    ),
    # The inverse of TURNED: a quarter turn about z to the other side, and (-2, 1, -3).
    "colmap": "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n"
    f"7 {HALF} 0 0 {-HALF} -2 1 -3 1 frame 10.jpg\n1.5 2.5 -1 3 4 8\n3 1 0 0 0 0 0 0 1 frame 2.jpg\n\n",
    "euroc": "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [], v\n"
    f"1403715524907143168,0,0,0,1,0,0,0,0.5,\n1403715525907143168,1,2,3,{HALF},0,0,{HALF},0.5,\n",
    "ros_csv": "%time,field.header.seq,field.header.stamp,field.header.frame_id,field.pose.position.x,"
    "field.pose.position.y,field.pose.position.z,field.pose.orientation.x,field.pose.orientation.y,"
    "field.pose.orientation.z,field.pose.orientation.w\n"
    "1403715524907143168,1,1403715524907143168,map,0,0,0,0,0,0,1\n"
    f"1403715525907143168,2,1403715525907143168,map,1,2,3,0,0,{HALF},{HALF}\n",
    "tum": f"# timestamp tx ty tz qx qy qz qw\n0 0 0 0 0 0 0 1\n0.1 1 2 3 0 0 {HALF} {HALF}\n",
    "nice_slam": "1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1\n0 -1 0 1 1 0 0 2 0 0 1 3 0 0 0 1\n",
    "kitti": "1 0 0 0 0 1 0 0 0 0 1 0\n0 -1 0 1 1 0 0 2 0 0 1 3\n",
    "redwood": "0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n1 1 2\n0 -1 0 1\n1 0 0 2\n0 0 1 3\n0 0 0 1\n",
    "habitat": '[{"position": [0, 0, 0], "rotation": [0, 0, 0, 1]},'
    f' {{"position": [1, 2, 3], "rotation": [0, 0, {HALF}, {HALF}]}}]',
}

APPLIED = '{"frames": [{"transform_matrix": [[1, 0, 0, 1], [0, 1, 0, 2], [0, 0, 1, 3]]}], %s}'


def write(folder: Path, kind: str, text: str = "") -> Path:
    path = folder / "poses.txt"  # the name says nothing
    path.write_text(text or LINES[kind])
    return path


@pytest.mark.parametrize("kind", LINES)
def test_every_format_says_the_same_poses_and_is_known_by_its_look(kind: str, tmp_path: Path) -> None:
    path = write(tmp_path, kind)
    for asked in (kind, "auto"):
        poses = read_poses(path, asked)
        np.testing.assert_allclose(poses, [np.eye(4), TURNED], atol=1e-15)
    assert find_file(path)[1] == kind


@pytest.mark.parametrize("rows", [3, 4])
def test_what_nerfstudio_has_applied_to_the_poses_is_undone(rows: int, tmp_path: Path) -> None:
    # x, z and -y, as ns-process-data writes them, then a move by (10, 20, 30); positions are halved after that.
    applied = np.array([[1, 0, 0, 10], [0, 0, 1, 20], [0, -1, 0, 30], [0, 0, 0, 1]])
    written = np.array([[0.0, -1, 0, 5.5], [0, 0, 1, 11.5], [-1, 0, 0, 14], [0, 0, 0, 1]])
    given = {
        "applied_transform": applied[:rows].tolist(),
        "applied_scale": 0.5,
        "frames": [{"file_path": "a.png", "transform_matrix": written.tolist()}],
    }
    assert read_poses(write(tmp_path, "", json.dumps(given))).tolist() == [TURNED.tolist()]


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
        ("tum", "0 0 0 x 0 0 0 1\n", "has a value that is not a number"),
        ("nice_slam", "1 0 0 0 0 1 0 0 0 0 -1 0 0 0 0 1\n", "pose 1 .* mirrors: its axes are left-handed"),
        ("nice_slam", "2 0 0 0 0 2 0 0 0 0 2 0 0 0 0 1\n", "pose 1 .* is not a rigid motion"),
        ("nice_slam", "nan 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1\n", "pose 1 .* is not a rigid motion"),
        ("nice_slam", "1 0 0 2e6 0 1 0 0 0 0 1 0 0 0 0 1\n", r"pose 1 .* is 2e\+06 m away"),
        ("kitti", "1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 0 0 1 0 -1e300 0 0 1 0\n", "pose 2 .* is 1e"),
        ("tum", "2 0 0 0 0 0 0 1\n1 1 0 0 0 0 0 1\n", "pose 2 .* has an earlier time stamp"),
        ("tum", "0 0 0 0 0 0 0 1\nnan 1 0 0 0 0 0 1\n", "pose 2 .* has an earlier time stamp"),
        ("tum", "inf 0 0 0 0 0 0 1\n", "a time stamp of .* is not a finite number"),
        ("tum", "# nothing\n", "holds no pose"),
        ("redwood", LINES["nice_slam"], "a line of 3 numbers and 4 lines of 4 numbers"),
        ("redwood", "# nothing\n", "not a Redwood trajectory"),
        ("redwood", LINES["redwood"].replace("-1", "x"), "has a value that is not a number"),
        ("habitat", '[{"position": [0, 0]}]', "not a trajectory of Habitat"),
        ("habitat", '[{"position": [0, 0, 0], "rotation": [0, 0, 0, 0.5]}]', "quaternion of length 0.5"),
        ("auto", " \n", "is empty: expected 8 numbers per line"),
        ("auto", "# a comment\n", "got comments only"),
        ("auto", '{"camera_model": "OPENCV", "poses": []}', "got JSON with the names camera_model, poses"),
        ("nerfstudio", '{"frames": []}', "is not a transforms.json of nerfstudio .*: at least one frame"),
        ("nerfstudio", '{"frames": [{"file_path": "a"}]}', "'transform_matrix' is missing"),
        ("nerfstudio", '{"frames": [{"transform_matrix": [[1, 2], [3, 4]]}]}', "4 x 4 or 3 x 4 numbers for each"),
        ("nerfstudio", '{"frames": [{"transform_matrix": [[1, 0, 0, 0], [0, 2, 0, 0], [0, 0, 1, 0]]}]}', "not a rigid"),
        ("nerfstudio", APPLIED % '"applied_scale": 0', "numbers as applied_transform and a positive applied_scale"),
        ("nerfstudio", APPLIED % '"applied_scale": NaN', "numbers as applied_transform and a positive applied_scale"),
        ("nerfstudio", APPLIED % '"applied_scale": "x"', "could not convert string to float"),
        ("nerfstudio", APPLIED % '"applied_scale": []', "a part of it is of another kind"),
        ("nerfstudio", APPLIED % '"applied_scale": 1e-320', "is inf m away|is not a rigid motion"),
        ("nerfstudio", APPLIED % '"applied_transform": null', "numbers as applied_transform and a positive"),
        ("nerfstudio", APPLIED % '"applied_transform": [[1, 0, 0], [0, 1, 0]]', "numbers as applied_transform and a"),
        (
            "nerfstudio",
            APPLIED % '"applied_transform": [[2, 0, 0, 0], [0, 2, 0, 0], [0, 0, 2, 0]]',
            "an applied_transform that is not a rotation and a translation",
        ),
        ("colmap", "1 2 3\n", "is not a COLMAP images.txt: expected IMAGE_ID QW"),
        ("colmap", "# Image list\n", "is a COLMAP model without images"),
        ("colmap", "1 2 0 0 0 0 0 0 1 a.jpg\n\n", "quaternion of length 2"),
        ("colmap", "1 1 0 0 0 0 0 0 1 a.jpg\n2 1 0 0 0 0 0 0 1 b 2.jpg\n", "no line of image points after .* 'a.jpg'"),
        ("colmap", "1 1 0 0 0 nan 0 0 1 a.jpg\n\n", "holds a translation over"),
        ("euroc", LINES["euroc"].replace(",1,2,", ",x,2,"), "is not a table of numbers"),
        ("euroc", LINES["euroc"].splitlines()[0], "no row of numbers follows its header"),
        ("ros_csv", "0,1,2,3,0,0,0,1\n", "has no header that names its columns"),
        (
            "auto",
            "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m]\n0,1,2,3\n",
            "without columns for qx, qy, qz, qw",
        ),
        ("auto", "time,x,y,z,qx,qy,qz,qw\n0,1,2,3\n", "row 1 of .* has 4 cells, fewer than its header"),
        ("spz", "", "unknown trajectory format 'spz'"),
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
    with pytest.warns(InputWarning, match="1 of 4 poses of .* are not finite"):
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


def colmap_binary(images: list[tuple[str, list[float], int]]) -> bytes:
    """The bytes of an images.bin: for each image a name, the quaternion wxyz and translation, a number of points."""
    content = struct.pack("<Q", len(images))
    for number, (name, numbers, points) in enumerate(images, start=1):
        content += struct.pack("<i7di", number, *numbers, 1) + name.encode() + b"\0" + struct.pack("<Q", points)
        content += struct.pack("<ddq", 1.5, 2.5, -1) * points
    return content


MODEL = colmap_binary([("b_10.jpg", [HALF, 0, 0, -HALF, -2, 1, -3], 2), ("b_9.jpg", [1, 0, 0, 0, 0, 0, 0], 0)])


@pytest.mark.parametrize("place", ["images.bin", "sparse/0/images.bin", "renamed.txt"])
def test_a_binary_model_of_colmap_is_inverted_and_sorted_by_name(place: str, tmp_path: Path) -> None:
    file = tmp_path / place
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(MODEL)
    for given in (file, *([tmp_path] if file.name == "images.bin" else [])):
        np.testing.assert_allclose(read_poses(given), [np.eye(4), TURNED], atol=1e-15)
        assert find_file(given) == (file, "colmap")


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (MODEL[:-1], "is cut off"),
        (MODEL[:-60], "is cut off"),
        (MODEL[:100], "images do not fit in its"),
        (MODEL + b"x", "data follow its 2 images"),
        (b"\xff" * 7 + b"\0" + MODEL[8:], "images do not fit in its"),
        (b"\x01" + b"\0" * 7 + MODEL[8:60], "images do not fit in its"),
    ],
)
def test_a_damaged_binary_model_is_refused(content: bytes, said: str, tmp_path: Path) -> None:
    (tmp_path / "images.bin").write_bytes(content)
    with pytest.raises(InputError, match=said):
        read_poses(tmp_path)


@pytest.mark.parametrize("encoding", ["utf-16-le", "utf-16-be"])
@pytest.mark.parametrize("kind", ["auto", "tum", "ros_csv", "colmap"])
def test_text_in_utf_16_is_named(kind: str, encoding: str, tmp_path: Path) -> None:
    path = tmp_path / "poses.txt"
    path.write_bytes(("\ufeff" + LINES["tum"]).encode(encoding))
    with pytest.raises(InputError, match="poses.txt' is UTF-16 text: save it as UTF-8"):
        read_poses(path, kind)


@pytest.mark.parametrize("count", [0xFEFF, 0xFFFE])
def test_a_binary_model_whose_count_is_a_byte_order_mark_is_no_text(count: int, tmp_path: Path) -> None:
    (tmp_path / "images.bin").write_bytes(struct.pack("<Q", count))
    assert find_file(tmp_path / "images.bin")[1] == "colmap"
    with pytest.raises(InputError, match="images do not fit in its 8 bytes"):
        read_poses(tmp_path / "images.bin")


def test_a_model_of_colmap_can_begin_with_a_byte_order_mark(tmp_path: Path) -> None:
    for text in (LINES["colmap"], LINES["colmap"].partition("\n")[2]):
        (tmp_path / "images.txt").write_text(text, encoding="utf-8-sig")
        np.testing.assert_allclose(read_poses(tmp_path), [np.eye(4), TURNED], atol=1e-15)


def test_the_points_of_an_image_can_be_whole_numbers(tmp_path: Path) -> None:
    text = "1 1 0 0 0 0 0 0 1 a.jpg\n1 2 -1 3 4 -1 5 6 -1 7 8 -1\n2 1 0 0 0 0 0 0 1 b.jpg\n"
    assert len(read_poses(write(tmp_path, "", text), "colmap")) == 2


def test_time_stamps_are_seconds(tmp_path: Path) -> None:
    for kind in ("euroc", "ros_csv"):
        stamps = read_recorded(write(tmp_path, kind)).stamps
        np.testing.assert_allclose(stamps, [1403715524.907143168, 1403715525.907143168], atol=1e-6)
    assert read_recorded(write(tmp_path, "tum")).stamps.tolist() == [0, 0.1]
    assert read_recorded(write(tmp_path, "kitti")).stamps is None
    named = write(tmp_path, "ros_csv", '"tx","ty","tz","qw","qx","qy","qz"\n1,2,3,1,0,0,0\n')
    assert read_recorded(named).poses[0, :3, 3].tolist() == [1, 2, 3]


SHORT = "tx,ty,tz,qx,qy,qz,qw"
BODY = "p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []"


@pytest.mark.parametrize(
    ("header", "times", "stamps"),
    [
        (SHORT, "", None),
        (f"frame,{SHORT}", "7,", None),
        (f"header.stamp.sec,header.stamp.nanosec,{SHORT}", "1700000000,250000000,", 1700000000.25),
        (f"/odom/header/stamp/sec,/odom/header/stamp/nanosec,{SHORT}", "3,5,", 3.000000005),
        (f"Time,header.stamp.secs,header.stamp.nsecs,{SHORT}", "9,3,500000000,", 3.5),
        (f"header.stamp.sec,{SHORT}", "3,", None),  # without the fraction
        (f"#timestamp [ns],{BODY}", "100000000,", 0.1),
        (f"#timestamp,{BODY}", "100000000,", 0.1),
        (f"#timestamp [nsec],{BODY}", "100000000,", 0.1),
        (f"timestamp [ns],{SHORT}", "100000000,", 0.1),
        (f"timestamp [ms],{SHORT}", "100,", 0.1),
        (f"timestamp,{SHORT}", "1403636579763555584,", 1403636579.7635555),
        (f"timestamp,{SHORT}", "1403636579763555,", 1403636579.763555),
        (f"timestamp,{SHORT}", "1403636579.763555,", 1403636579.763555),
    ],
)
def test_the_unit_of_time_stamps_is_named_or_follows_from_their_size(
    header: str, times: str, stamps: float | None, tmp_path: Path
) -> None:
    pose = "1,2,3,1,0,0,0" if BODY in header else "1,2,3,0,0,0,1"
    found = read_recorded(write(tmp_path, "", f"{header}\n{times}{pose}\n"))
    assert found.poses[0, :3].tolist() == [[1, 0, 0, 1], [0, 1, 0, 2], [0, 0, 1, 3]]
    assert (found.stamps if stamps is None else found.stamps.tolist()) == (stamps and [stamps])


def test_poses_of_a_csv_file_without_times_match_by_index(tmp_path: Path) -> None:
    csv = write(tmp_path, "", f"{SHORT}\n" + "0,0,0,0,0,0,1\n" * 3)
    assert [len(found) for found in matched(3, read_recorded(csv).stamps, 3, np.array([0.0, 0.5, 1.0]))] == [3, 3]


def test_eight_columns_of_euroc_have_no_need_of_a_header(tmp_path: Path) -> None:
    text = f"1403715524907143168,0,0,0,1,0,0,0\n1403715525907143168,1,2,3,{HALF},0,0,{HALF}\n"
    assert find_file(path := write(tmp_path, "", text))[1] == "euroc"
    np.testing.assert_allclose(read_poses(path), [np.eye(4), TURNED], atol=1e-15)
    for other in ("1403715524907143168 0 0 0 0 0 0 1", "1403715524.9,0,0,0,0,0,0,1"):
        assert find_file(write(tmp_path, "", other))[1] == "tum"


@pytest.mark.parametrize(
    ("place", "kind", "poses"),
    [
        ("trajectories/freiburg1_xyz-groundtruth.txt", "tum", 3000),
        ("trajectories/fr2_desk_groundtruth.txt", "tum", 20957),
        ("icl_nuim", "redwood", 211),
    ],
)
def test_real_files(shared: Path, place: str, kind: str, poses: int) -> None:
    file = shared / "data" / place
    assert find_file(file)[1] == kind and len(read_poses(file)) == poses
