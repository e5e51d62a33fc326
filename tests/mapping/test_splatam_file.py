import numpy as np
import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.geometry.rotations import quaternion_of, turned
from activestructure_gym.mapping import GaussianMap, write_ply
from activestructure_gym.mapping.files import map_kind, read_map
from activestructure_gym.mapping.splatam_file import read_splatam, splatam_path, write_splatam

CAMERA = PinholeCamera.from_size(96, 54)


@pytest.fixture
def poses() -> np.ndarray:
    return np.stack([look_along(np.array([1.0, 2.0, x]), np.array([1.0, x, -0.3])) for x in (1.2, 1.4, 1.7)])


@pytest.fixture
def gaussians(rng) -> GaussianMap:
    made = GaussianMap()
    made.append(rng.normal(size=(14, 300)).astype(np.float32))
    return made


def test_the_way_there_and_back(tmp_path, gaussians, poses):
    file = tmp_path / "params.npz"
    write_splatam(gaussians, file, poses, CAMERA, np.array([0, 2]))
    assert map_kind(file) == "splatam"
    back = read_map(file)
    for name in ("means", "scales", "opacities", "colors"):
        np.testing.assert_allclose(getattr(back, name), getattr(gaussians, name), rtol=1e-4, atol=1e-5)
    dots = np.abs((back.quaternions * gaussians.quaternions).sum(axis=1))
    np.testing.assert_allclose(dots, 1.0, atol=1e-5)
    path = splatam_path(file)
    assert path is not None
    np.testing.assert_allclose(path["world_from_camera"], poses, atol=1e-9)
    np.testing.assert_array_equal(path["keyframes"], [0, 2])
    np.testing.assert_allclose(path["intrinsics"], [48, 48, 48, 27])


def test_the_file_is_splatam_s(tmp_path, gaussians, poses):
    write_splatam(gaussians, tmp_path / "params.npz", poses, CAMERA, np.array([0, 2]))
    with np.load(tmp_path / "params.npz") as file:
        content = dict(file)
    shapes = {
        "means3D": (300, 3), "rgb_colors": (300, 3), "unnorm_rotations": (300, 4), "logit_opacities": (300, 1),
        "log_scales": (300, 3), "cam_unnorm_rots": (1, 4, 3), "cam_trans": (1, 3, 3), "timestep": (300,),
        "intrinsics": (3, 3), "w2c": (4, 4), "gt_w2c_all_frames": (3, 4, 4), "keyframe_time_indices": (2,),
    }  # fmt: skip
    assert {name: content[name].shape for name in shapes} == shapes
    # Frame 0 is the frame of the map: a point one metre before its camera has z = 1 in the file.
    ahead = poses[0][:3, 3] + poses[0][:3, 2]
    gaussians.parameters[:3, 0] = ahead
    write_splatam(gaussians, tmp_path / "params.npz", poses, CAMERA, np.array([0, 2]))
    with np.load(tmp_path / "params.npz") as file:
        np.testing.assert_allclose(file["means3D"][0], [0, 0, 1], atol=1e-6)
        np.testing.assert_allclose(file["gt_w2c_all_frames"][0], np.eye(4), atol=1e-12)


def test_a_file_of_the_original(tmp_path, poses):
    """Isotropic scales, no word of the world: the first pose comes from elsewhere."""
    file = tmp_path / "params.npz"
    content = {
        "means3D": np.array([[0.0, 0.0, 2.0]], np.float32), "rgb_colors": np.array([[0.1, 0.5, 1.2]], np.float32),
        "unnorm_rotations": np.array([[2.0, 0, 0, 0]], np.float32), "logit_opacities": np.zeros((1, 1), np.float32),
        "log_scales": np.full((1, 1), -3.0, np.float32), "gt_w2c_all_frames": np.eye(4)[None],
    }  # fmt: skip
    np.savez(file, **content)
    placed = read_splatam(file, poses[0])
    np.testing.assert_allclose(placed.means[0], poses[0][:3, 3] + 2 * poses[0][:3, 2], atol=1e-6)
    np.testing.assert_allclose(placed.scales[0], np.exp(-3.0), rtol=1e-6)
    np.testing.assert_allclose(placed.opacities, 0.5)
    with pytest.warns(UserWarning, match="no world pose of its first camera"):
        np.testing.assert_allclose(read_splatam(file).means[0], [0, 0, 2])
    assert splatam_path(file) is None
    content["means3D"] = np.array([[np.nan, 0, 0]], np.float32)
    np.savez(file, **content)
    with pytest.warns(UserWarning, match="dropped 1 of 1"):
        assert read_splatam(file, poses[0]).count == 0


def test_rotations_turn_as_matrices_do(poses):
    from scipy.spatial.transform import Rotation

    first, second = poses[0][:3, :3], poses[2][:3, :3]
    product = turned(quaternion_of(first), quaternion_of(second)[None])[0]
    np.testing.assert_allclose(Rotation.from_quat(product[[1, 2, 3, 0]]).as_matrix(), first @ second, atol=1e-12)


def test_files_that_are_no_maps(tmp_path, gaussians):
    with pytest.raises(InputError, match="no file"):
        read_map(tmp_path / "nothing")
    (tmp_path / "text").write_text("hello")
    with pytest.raises(InputError, match="is not a map file"):
        read_map(tmp_path / "text")
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    with pytest.raises(InputError, match="is not a map file"):
        read_map(tmp_path / "other.npz")
    np.savez(tmp_path / "half.npz", means3D=np.zeros((2, 3)))
    with pytest.raises(InputError, match="rgb_colors"):
        read_map(tmp_path / "half.npz")
    np.savez(
        tmp_path / "odd.npz", means3D=np.zeros((2, 3)), rgb_colors=np.zeros((2, 3)), unnorm_rotations=np.zeros((2, 3)),
        logit_opacities=np.zeros((2, 1)), log_scales=np.zeros((2, 1)),
    )  # fmt: skip
    with pytest.raises(InputError, match="unnorm_rotations.*shape"):
        read_map(tmp_path / "odd.npz")
    gaussians.save_npz(tmp_path / "map.npz")
    write_ply(gaussians, tmp_path / "map.ply")
    assert (map_kind(tmp_path / "map.npz"), map_kind(tmp_path / "map.ply")) == ("npz", "ply")
    assert read_map(tmp_path / "map.ply").count == read_map(tmp_path / "map.npz").count == 300
