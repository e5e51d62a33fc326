import itertools

import numpy as np
import pytest

from activestructure_gym.evaluation.metrics import SurfaceSamples
from activestructure_gym.evaluation.protocols import CameraPath, StandardProtocol, Truth
from activestructure_gym.evaluation.protocols.visibility import seen_by_keyframes, seen_on_paths
from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.ground_truth import ground_truth_of
from activestructure_gym.ground_truth.surface_samples import uniform_samples
from activestructure_gym.scenes import load_scene
from activestructure_gym.scenes.scene import Scene, SceneMesh
from activestructure_gym.sensors.renderer import make_renderer

CAMERA = PinholeCamera.from_size(160, 90, 90.0)
MARGIN = 2e-3


def path_of(poses: list[np.ndarray], camera: PinholeCamera = CAMERA, reach: float = 10.0) -> CameraPath:
    keyframes = np.array(poses).reshape(-1, 4, 4)
    return CameraPath(camera, np.eye(4), keyframes, reach)


@pytest.fixture(scope="module")
def scene():
    return load_scene("room?seed=11")


@pytest.fixture(scope="module")
def samples(scene) -> np.ndarray:
    return uniform_samples(scene.mesh.vertices, scene.mesh.faces, 3000, np.random.default_rng(0))[0]


@pytest.fixture(scope="module")
def poses(scene) -> list[np.ndarray]:
    rng = np.random.default_rng(1)
    places = ground_truth_of(scene).free_space.sample_positions(12, rng, min_clearance=0.3)
    return [look_along(place, rng.normal(size=3) * [1, 1, 0.3]) for place in places]


def first_hits(scene, eye: np.ndarray, points: np.ndarray) -> np.ndarray:  # [S] metres along the ray
    way = points - eye
    directions = (way / np.linalg.norm(way, axis=1)[:, None]).astype(np.float32)
    return scene.raycaster.cast(eye.astype(np.float32), directions).distance


def test_it_agrees_with_the_first_hit_of_a_ray_to_every_sample(scene, samples, poses):
    expected, doubtful = np.zeros(len(samples), bool), np.zeros(len(samples), bool)
    for pose in poses:
        eye = pose[:3, 3]
        local = (samples - eye) @ pose[:3, :3]  # right, down, ahead
        # 90 degrees across, 16 : 9: the image ends where |right| = ahead and |down| = 9 / 16 ahead.
        inside = np.maximum(np.abs(local[:, 0]), np.abs(local[:, 1]) * 16 / 9) < local[:, 2]
        gap = np.linalg.norm(samples - eye, axis=1) - first_hits(scene, eye, samples)
        expected |= inside & (gap < MARGIN)
        doubtful |= inside & (np.abs(gap - MARGIN) < 1e-4)
    found = seen_by_keyframes(samples, path_of(poses), scene, MARGIN)
    assert 0.1 < expected.mean() < 0.9 and doubtful.mean() < 0.01
    np.testing.assert_array_equal(found[~doubtful], expected[~doubtful])


def test_many_paths_at_once_are_each_path_alone(scene, samples, poses):
    """Paths share poses, one has none, and their lines of sight fill several batches."""
    ways = [np.stack(poses[a:b]) if b > a else np.zeros((0, 4, 4)) for a, b in ((0, 3), (1, 1), (2, 12), (0, 12))]
    ways += [pose[None] for pose in poses]
    expected = [seen_by_keyframes(samples, path_of(list(way)), scene, MARGIN) for way in ways]
    for points, right in ((samples, expected), (samples[:5], [one[:5] for one in expected])):
        for rays in (1, 1500, 1 << 17):
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr("activestructure_gym.evaluation.protocols.visibility._RAYS", rays)
                found = seen_on_paths(points, ways, CAMERA, 10.0, scene, MARGIN)
            np.testing.assert_array_equal(found, np.stack(right))
    assert seen_on_paths(samples, [], CAMERA, 10.0, scene, MARGIN).shape == (0, len(samples))
    assert seen_on_paths(samples[:0], ways, CAMERA, 10.0, scene, MARGIN).shape == (len(ways), 0)
    assert found.dtype == bool and not expected[1].any() and expected[3].sum() > expected[0].sum() > 0


def test_what_the_depth_image_shows_is_seen_and_what_lies_behind_is_not(scene, poses):
    renderer = make_renderer("raycast", scene)
    rows, columns = np.mgrid[4:90:8, 4:160:8].reshape(2, -1)
    for pose in poses[:4]:
        depth = renderer.render(CAMERA, pose, supersample=1)[1][rows, columns].astype(np.float64)
        rays = np.stack(
            [(columns + 0.5 - CAMERA.cx) / CAMERA.fx, (rows + 0.5 - CAMERA.cy) / CAMERA.fy, np.ones(len(rows))], axis=1
        )
        shown = (rays * depth[:, None]) @ pose[:3, :3].T + pose[:3, 3]
        behind = (rays * (depth[:, None] + 0.1)) @ pose[:3, :3].T + pose[:3, 3]
        hit = (depth > 0) & (depth < 10)
        assert seen_by_keyframes(shown[hit], path_of([pose]), scene, MARGIN).mean() > 0.99  # a ray may graze an edge
        assert not seen_by_keyframes(behind[hit], path_of([pose]), scene, MARGIN).any()
    renderer.close()


def test_it_never_falls_along_a_run_and_begins_with_nothing(scene, samples, poses):
    seen = [seen_by_keyframes(samples, path_of(poses[:count]), scene, MARGIN) for count in range(len(poses) + 1)]
    assert not seen[0].any()
    assert all((later | earlier == later).all() for earlier, later in zip(seen, seen[1:]))
    assert seen[-1].sum() > seen[1].sum() > 0


def test_an_empty_box_is_seen_whole_from_inside_by_six_views():
    corners = np.array(list(itertools.product((0.0, 4.0), (0.0, 3.0), (0.0, 2.0))), np.float32)
    quads = np.array([[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]])
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.int32)
    mesh = SceneMesh(
        corners, faces, np.ones((8, 3), np.float32), np.zeros((8, 2), np.float32), np.full(12, -1, np.int32)
    )
    walls = uniform_samples(corners, faces, 2000, np.random.default_rng(0))[0]
    truth = Truth(SurfaceSamples(walls, np.zeros_like(walls), 52.0), None, Scene("a box", mesh, "by hand"))
    square = PinholeCamera.from_size(99, 99, 91.0)
    ways = [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [1e-6, 0, 1], [1e-6, 0, -1]]
    views = [look_along(np.array([2.0, 1.5, 1.0]), np.array(way, float)) for way in ways]
    protocol = StandardProtocol()
    assert protocol.observed(truth, path_of([], square)) == 0.0
    assert protocol.observed(truth, path_of(views, square)) == 100.0
    assert protocol.observed(truth, path_of(views, square, 0.9)) == 0.0  # the nearest wall is 1 m away
    # A view along x takes the end of 3 x 2 m and some of the four sides; both ways alike, up to the samples.
    one, other = (protocol.observed(truth, path_of([view], square)) for view in views[:2])
    assert one == pytest.approx(other, abs=3.0) and 100 * 6 / 52 - 2 < one < 50.0
