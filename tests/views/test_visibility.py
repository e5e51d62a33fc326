"""Which planes a view sees, by hand."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.views import visibility, visible_planes
from activestructure_gym.views.visibility import SAMPLES, visible_cosines
from activestructure_gym.volume import OCCUPIED, VolumeConfig, VoxelVolume

CAMERA = PinholeCamera.from_size(40, 24)


def patch(center: tuple[float, float, float], normal_axis: int) -> np.ndarray:  # [9, 3]
    grid = np.stack(np.meshgrid([-0.1, 0, 0.1], [-0.1, 0, 0.1]), axis=-1).reshape(-1, 2)
    return np.asarray(center) + np.insert(grid, normal_axis, 0.0, axis=1)


def plane_of(points: np.ndarray, normal: np.ndarray) -> SimpleNamespace:
    at = np.arange(SAMPLES) * (len(points) - 1) // (SAMPLES - 1)
    return SimpleNamespace(spread=lambda count: points[at][:count], normal=normal)


def test_frustum_distance_and_angle() -> None:
    here = look_along(np.zeros(3), np.array([1.0, 0.0, 0.0]))
    back = look_along(np.zeros(3), np.array([-1.0, 0.0, 0.0]))
    planes = [
        plane_of(points, np.asarray(normal, float))
        for points, normal in [
            (patch((2.0, 0.0, 0.0), 0), (-1, 0, 0)),  # ahead, frontal
            (patch((2.0, 0.0, 0.0), 0), (1, 0, 0)),  # ahead, but its face looks away
            (patch((6.0, 0.0, 0.0), 0), (-1, 0, 0)),  # beyond 5 m
            (patch((2.0, 0.0, -0.2), 2), (0, 0, 1)),  # ahead but seen at 84 degrees from its normal
            (patch((0.0, 2.0, 0.0), 1), (0, -1, 0)),  # to the left, outside 90 degrees
            (patch((0.1, 0.0, 0.0), 0), (-1, 0, 0)),  # nearer than 0.2 m
        ]
    ]
    seen = visible_planes(planes, CAMERA, np.stack([here, back]))
    np.testing.assert_array_equal(seen, [[True] + [False] * 5, [False] * 6])


def test_what_is_occupied_hides_what_is_behind() -> None:
    volume = VoxelVolume(np.array([[-1.0, -1, -1], [3.0, 1, 1]]), VolumeConfig())
    plane = plane_of(patch((2.0, 0.0, 0.0), 0), np.array([-1.0, 0, 0]))
    here = look_along(np.zeros(3), np.array([1.0, 0.0, 0.0]))[None]
    assert visible_planes([plane], CAMERA, here, volume).all()
    wall = (volume.center_of(np.indices(volume.shape).transpose(1, 2, 3, 0))[..., 0] - 1.0) ** 2 < 0.05**2
    volume.state[wall] = OCCUPIED
    assert not visible_planes([plane], CAMERA, here, volume).any()


def test_stopping_early_changes_no_answer(rng: np.random.Generator) -> None:
    volume = VoxelVolume(np.array([[-4.0, -4, -4], [4.0, 4, 4]]), VolumeConfig())
    volume.state[rng.random(volume.shape) < 0.02] = OCCUPIED
    points, normals = rng.uniform(-3, 3, (40, 1, 3)) + rng.normal(0, 0.3, (40, 16, 3)), rng.normal(size=(40, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    poses = np.stack([look_along(rng.uniform(-1, 1, 3), rng.normal(size=3)) for _ in range(30)])
    cosines, counts = visible_cosines(points, normals, CAMERA, poses, volume)
    np.testing.assert_array_equal(counts, (cosines > 0).sum(axis=2))
    assert {0, 1, 2, 3} <= set(counts.ravel().tolist())
    for enough in (1, 2, 5, 16):
        _, early = visible_cosines(points, normals, CAMERA, poses, volume, enough=enough)
        np.testing.assert_array_equal(early == enough, counts >= enough)


def test_any_number_of_threads_gives_the_same(rng: np.random.Generator, monkeypatch) -> None:
    volume = VoxelVolume(np.array([[-4.0, -4, -4], [4.0, 4, 4]]), VolumeConfig())
    volume.state[rng.random(volume.shape) < 0.02] = OCCUPIED
    points, normals = rng.uniform(-3, 3, (60, 4, 3)), rng.normal(size=(60, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    poses = np.stack([look_along(rng.uniform(-1, 1, 3), rng.normal(size=3)) for _ in range(50)])
    assert len(poses) * len(points) >= visibility._WORTH_A_THREAD
    results = []
    for threads in (1, 2, 3):
        monkeypatch.setattr(visibility, "default_threads", lambda count=threads: count)
        results.append(visible_cosines(points, normals, CAMERA, poses, volume, enough=2))
    assert results[0][1].any()
    for cosines, counts in results[1:]:
        np.testing.assert_array_equal(cosines, results[0][0])
        np.testing.assert_array_equal(counts, results[0][1])


def test_nothing_beyond_the_farthest_depth_counts() -> None:
    here = look_along(np.zeros(3), np.array([1.0, 0.0, 0.0]))[None]
    points, normals = np.array([[[2.0, 0, 0]], [[2.0, 0, 0]]]), np.tile([-1.0, 0, 0], (2, 1))
    _, counts = visible_cosines(points, normals, CAMERA, here, farthest=np.array([1.9, 2.1]))
    np.testing.assert_array_equal(counts, [[0, 1]])


def test_empty_inputs() -> None:
    plane = plane_of(patch((2.0, 0.0, 0.0), 0), np.array([-1.0, 0, 0]))
    assert visible_planes([], CAMERA, np.eye(4)[None]).shape == (1, 0)
    assert visible_planes([plane] * 2, CAMERA, np.zeros((0, 4, 4))).shape == (0, 2)


def test_compiled_view_test_agrees_with_the_formula(rng: np.random.Generator) -> None:
    points, normals = rng.uniform(-4, 4, (30, 16, 3)), rng.normal(size=(30, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    planes = [plane_of(p, n) for p, n in zip(points, normals)]
    poses = np.stack([look_along(rng.uniform(-1, 1, 3), rng.normal(size=3)) for _ in range(20)])
    expected = np.zeros((20, 30), dtype=bool)
    for k, pose in enumerate(poses):
        local = (points - pose[:3, 3]) @ pose[:3, :3]
        distance = np.linalg.norm(local, axis=-1)
        ahead = local[..., 2] > 0
        pixel = CAMERA.project(np.where(ahead[..., None], local, 1.0))
        inside = (pixel >= 0).all(-1) & (pixel < [CAMERA.width, CAMERA.height]).all(-1)
        cosine = np.einsum("psi,pi->ps", pose[:3, 3] - points, normals) / distance
        seen = ahead & inside & (distance >= 0.2) & (distance <= 5.0) & (cosine >= np.cos(np.radians(80.0)))
        expected[k] = seen.mean(axis=1) >= 0.1
    assert 0.02 < expected.mean() < 0.98
    np.testing.assert_array_equal(visible_planes(planes, CAMERA, poses), expected)
