"""A trained splat as a world: the map of a run, explored again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from activestructure_gym.envs import ReconstructionEnv
from activestructure_gym.errors import InputError
from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.mapping.axes import FILE_FROM_WORLD, turned_map
from activestructure_gym.mapping.files import read_map
from activestructure_gym.mapping.gaussian_map import LOG_SCALE, OPACITY_LOGIT, QUATERNION, ROWS, GaussianMap
from activestructure_gym.mapping.keyframe_mapper import psnr
from activestructure_gym.mapping.ply import write_ply
from activestructure_gym.scenes import load_scene
from activestructure_gym.worlds import CaptureFailed, load_world
from activestructure_gym.worlds.splat_world import SplatWorld
from tests.worlds.splats import CONFIG, explored

GARDEN = Path(__file__).resolve().parents[3] / "shared" / "data" / "splats" / "gsplat_test_garden.npz"


@pytest.fixture(scope="module")
def box(splat_box: Path) -> Path:
    return splat_box


def made(file: Path, **options: object) -> SplatWorld:
    query = "".join(f"&{key}={value}" for key, value in {"width": 64, "height": 36, **options}.items())
    world = load_world(f"splat?file={file}{query}")
    assert isinstance(world, SplatWorld)
    return world


def inside_views(count: int) -> list[np.ndarray]:
    rng = np.random.default_rng(3)
    places = np.array([2.0, 1.5, 1.2]) + rng.uniform(-0.6, 0.6, (count, 3)) * (1.0, 1.0, 0.4)
    yaw = rng.uniform(0.0, 2 * np.pi, count)
    return [look_along(place, np.array([np.cos(a), np.sin(a), 0.0])) for place, a in zip(places, yaw)]


def test_the_map_of_a_run_explored_again(box: Path) -> None:
    world = made(box)
    second = explored(
        ReconstructionEnv(world, preset="fast", frame_budget=60, config=CONFIG, features=("hole_area",)), "hole_area"
    )
    quality, apart = [], []
    for pose in inside_views(8):
        first = world.capture(pose)
        again = second.render(world.camera, pose)
        quality.append(psnr(np.clip(again.color, 0, 1), first.rgb / np.float32(255)))
        shown = (first.depth > 0) & (again.alpha > 0.5)
        assert shown.mean() > 0.9
        apart.append(np.median(np.abs(again.depth / np.maximum(again.alpha, 1e-6) - first.depth)[shown]))
    assert np.median(quality) > 25.0  # dB, at views that were not captured
    assert np.median(apart) < 0.02  # metres


def test_depth_is_that_of_the_walls(box: Path) -> None:
    world, scene = made(box), load_scene("box?seed=0")
    rays = world.camera.rays().reshape(-1, 3)
    for pose in inside_views(4):
        frame = world.capture(pose)
        true = scene.raycaster.cast(pose[:3, 3], rays @ pose[:3, :3].T).distance.reshape(frame.depth.shape)
        shown = frame.depth > 0
        assert shown.mean() > 0.9 and np.median(np.abs(frame.depth - true)[shown]) < 0.03
        np.testing.assert_array_equal(frame.world_from_camera, pose)


def test_bounds_and_start_are_found(box: Path) -> None:
    world = made(box)
    np.testing.assert_allclose(world.bounds, [[-0.1, -0.1, -0.1], [4.1, 3.1, 2.6]], atol=0.15)
    place = world.start.pose[:3, 3]
    truth = float(np.minimum(place, np.array([4.0, 3.0, 2.5]) - place).min())
    assert 0.3 <= world.start.free_radius <= truth + 0.03
    assert (made(box, bounds="-3,0,0,4,3,2.5").start.pose[:3, 3] > 0.3).all()  # inside, where all directions end
    far = made(box, bounds="2.6,0,0,4,3,2.5")
    np.testing.assert_allclose(far.start.pose[:3, 2], [-1.0, 0.0, 0.0], atol=1e-9)  # the way to the farthest wall
    given = made(box, start="1.0,1.5,1.2,90", bounds="0,0,0,4,3,2.5")
    np.testing.assert_allclose(given.start.pose[:3, 2], [0.0, 1.0, 0.0], atol=1e-9)
    for near in ("0.0,1.5,1.2,90", "0.2,1.5,1.2,90"):  # in a wall, and 0.2 m before it
        with pytest.raises(InputError, match="from the map's surface, and needs 0.3 m"):
            made(box, start=near, bounds="0,0,0,4,3,2.5")
    assert 0.9 < given.start.free_radius < 1.03 and given.bounds[1].tolist() == [4.0, 3.0, 2.5]


def test_another_up_axis_gives_the_same_world(box: Path, tmp_path: Path) -> None:
    write_ply(turned_map(read_map(box), FILE_FROM_WORLD["y"]), tmp_path / "y.ply", up="y")
    one, other = made(box), made(tmp_path / "y.ply", up="y")
    np.testing.assert_allclose(one.bounds, other.bounds, atol=1e-5)
    pose = inside_views(1)[0]
    a, b = one.capture(pose), other.capture(pose)
    assert np.median(np.abs(a.depth - b.depth)) < 1e-4 and np.abs(a.rgb.astype(int) - b.rgb).mean() < 0.5


def test_a_collision_mesh_gives_start_and_failure(box: Path, tmp_path: Path) -> None:
    import trimesh

    mesh = load_scene("box?seed=0").mesh
    trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(tmp_path / "box.ply")
    world = made(box, collision=tmp_path / "box.ply")
    assert (world.capture(world.start.pose).depth > 0).mean() > 0.9
    outside = world.start.pose.copy()
    outside[0, 3] = 4.5
    with pytest.raises(CaptureFailed, match="not in the collision mesh's free space"):
        world.capture(outside)
    assert made(box).capture(outside).rgb.shape == (36, 64, 3)  # without a mesh it is rendered
    with pytest.raises(InputError, match="start pose at .* is"):
        made(box, collision=tmp_path / "box.ply", start="4.5,1,1,0")


def ball(opacity: float) -> GaussianMap:
    block = np.zeros((ROWS, 1), np.float32)
    block[QUATERNION, 0], block[LOG_SCALE, 0] = (1, 0, 0, 0), np.log(0.05)
    block[OPACITY_LOGIT, 0] = np.log(opacity / (1 - opacity))
    gaussians = GaussianMap(1)
    gaussians.append(block)
    return gaussians


def test_background_and_no_return_where_the_map_is_transparent(tmp_path: Path) -> None:
    write_ply(ball(0.9), tmp_path / "ball.ply")
    world = made(tmp_path / "ball.ply", start="-1,0,0,0", bounds="-2,-2,-2,2,2,2", background="1,0.5,0")
    frame = world.capture(world.start.pose)
    assert frame.rgb[0, 0].tolist() == [255, 128, 0] and frame.depth[0, 0] == 0.0
    assert frame.depth[18, 32] == pytest.approx(1.0, abs=0.06)
    assert world.camera == PinholeCamera.from_size(64, 36)


def test_maps_and_options_that_cannot_be_used(box: Path, tmp_path: Path) -> None:
    write_ply(ball(0.3), tmp_path / "thin.ply")
    write_ply(ball(0.9), tmp_path / "ball.ply")
    (tmp_path / "text.ply").write_text("hello")
    for file, options, message in (
        (tmp_path / "gone.ply", {}, "there is no file"),
        (tmp_path / "text.ply", {}, "is not a map file"),
        (tmp_path / "thin.ply", {}, "no Gaussian with an opacity of at least 0.5"),
        (tmp_path / "ball.ply", {}, "no position in the map has 0.3 m of free space"),
        (box, {"up": "w"}, "unknown up axis 'w'"),
        (box, {"background": "2,0,0"}, "from 0 to 1"),
        (box, {"width": 0}, "this camera cannot be used"),
        (box, {"bounds": "0,0,0,0,0,0"}, "lowest and the highest"),
    ):
        with pytest.raises(InputError, match=message):
            made(file, **options)


@pytest.mark.skipif(not GARDEN.is_file(), reason="gsplat's garden is not here")
def test_a_real_capture(tmp_path: Path) -> None:
    """Its points, as balls of the size of their spacing, from where its cameras were."""
    from scipy.spatial import cKDTree

    with np.load(GARDEN) as given:
        means, colours, poses = given["means3d"], given["colors"] / 255.0, np.linalg.inv(given["viewmats"])
    block = np.zeros((ROWS, len(means)), np.float32)
    block[:3], block[3] = means.T, 1.0
    block[LOG_SCALE] = np.log(np.clip(cKDTree(means).query(means, k=4)[0][:, 3], 1e-4, 0.1))
    block[OPACITY_LOGIT], block[-3:] = 3.0, colours.T
    gaussians = GaussianMap(len(means))
    gaussians.append(block)
    write_ply(gaussians, tmp_path / "garden.ply")
    world = made(tmp_path / "garden.ply", start=",".join(map(str, [*poses[0][:3, 3], 0])), bounds="-9,-9,-9,9,9,9")
    frame = world.capture(poses[0])
    assert (frame.depth > 0).mean() > 0.3 and frame.rgb.std() > 20
