"""The evaluation of ANM-S and ActiveSplat: a true point is complete if any frame saw a surface near it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.metrics import SurfaceSamples
from activestructure_gym.evaluation.protocols import ActiveSplatProtocol, CameraPath, StandardProtocol, Truth
from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.ground_truth import GroundTruth, ground_truth_of
from activestructure_gym.ground_truth.observable import first_viewpoint
from activestructure_gym.mapping import GaussianMap
from activestructure_gym.scenes import load_scene
from activestructure_gym.scenes.scene import Scene, SceneMesh

CAMERA = PinholeCamera.from_size(64, 64, 90.0)
SMALL = ActiveSplatProtocol(surface_samples=4000, scanned=False)
AHEAD = look_along(np.zeros(3), np.array([1.0, 0.0, 0.0]))


def walls(*distances: float, cells: int = 1) -> Scene:
    """Return squares of 1 x 1 m, of ``cells`` x ``cells`` quads each, one behind the other along x."""
    ticks = np.linspace(-0.5, 0.5, cells + 1)
    corners = np.array([[x, y, z] for x in distances for y in ticks for z in ticks], np.float32)
    first = np.arange(len(corners)).reshape(len(distances), cells + 1, cells + 1)[:, :-1, :-1].reshape(-1, 1, 1)
    faces = (first + [[0, 1, cells + 2], [0, cells + 2, cells + 1]]).reshape(-1, 3).astype(np.int32)
    flat = np.full(len(faces), -1, np.int32)
    mesh = SceneMesh(corners, faces, np.ones_like(corners), np.zeros((len(corners), 2), np.float32), flat)
    return Scene("walls", mesh, "by hand")


def path_of(*frames: np.ndarray, camera: PinholeCamera = CAMERA, reach: float = 10.0) -> CameraPath:
    poses = np.array(frames).reshape(-1, 4, 4)
    return CameraPath(camera, poses[0], poses[:1], reach, poses)


def test_a_hidden_wall_near_a_seen_one_is_complete_here_and_unobserved_in_standard() -> None:
    scene, path = walls(1.0, 1.03, 1.5), path_of(AHEAD)
    truth = SMALL.truth(GroundTruth(scene))
    found = SMALL.evaluate(GaussianMap(), truth, path)
    assert found["completion_ratio"] == pytest.approx(200 / 3, abs=0.1)  # the walls at 1 and 1.03 m
    assert found["completion_cm"] == pytest.approx((0.5 + 3.0 + 50.0) / 3, abs=0.4)
    standard = Truth(SurfaceSamples(truth.points, np.zeros_like(truth.points), 3.0), None, scene)
    assert StandardProtocol().observed(standard, path) == pytest.approx(100 / 3, abs=0.1)


def test_distances_count_up_to_one_metre() -> None:
    scene = walls(1.0, 9.0)
    found = SMALL.evaluate(GaussianMap(), SMALL.truth(GroundTruth(scene)), path_of(AHEAD))
    assert found["completion_cm"] == pytest.approx(50.0, abs=0.5) and found["completion_ratio"] == 50.0


def test_all_frames_count_and_the_accuracy_is_that_of_the_last_one() -> None:
    scene = load_scene("room?seed=11")
    known = ground_truth_of(scene)
    places = known.free_space.sample_positions(3, np.random.default_rng(0), min_clearance=0.3)
    frames = [look_along(place, np.array([np.cos(k), np.sin(k), -0.2])) for k, place in enumerate(places)]
    truth = SMALL.truth(known)
    found = SMALL.evaluate(GaussianMap(), truth, path_of(*frames))
    # As the original: the least distance over the frames, each with a search tree of its own.
    clouds = list(SMALL.seen(scene, path_of(*frames)))
    assert [len(cloud) for cloud in clouds] == [128 * 128] * 3
    nearest = np.minimum.reduce([np.ones(len(truth.points)), *(cKDTree(c).query(truth.points)[0] for c in clouds)])
    assert found["completion_cm"] == pytest.approx(100 * nearest.mean(), rel=1e-9)
    assert found["completion_ratio"] == pytest.approx(100 * np.mean(nearest < 0.05), rel=1e-12)
    assert found["accuracy_cm"] == pytest.approx(100 * cKDTree(truth.points).query(clouds[-1])[0].mean(), rel=1e-9)
    one = SMALL.evaluate(GaussianMap(), truth, path_of(*frames[:1]))
    assert one["completion_ratio"] < found["completion_ratio"]


def test_surface_within_10_m_is_seen_whatever_the_planner_s_range() -> None:
    truth = SMALL.truth(GroundTruth(walls(3.0)))
    near, far = (SMALL.evaluate(GaussianMap(), truth, path_of(AHEAD, reach=reach)) for reach in (2.0, 10.0))
    assert near == far and near["completion_ratio"] > 90.0
    found = SMALL.evaluate(GaussianMap(), SMALL.truth(GroundTruth(walls(10.5))), path_of(AHEAD, reach=20.0))
    assert found["completion_ratio"] == 0.0 and found["completion_cm"] == 100.0
    assert found["accuracy_cm"] is None and "saw nothing" in found["notes"]["accuracy_cm"]


def test_surface_that_no_scanner_sees_is_left_out() -> None:
    known = ground_truth_of(load_scene("room?seed=11"))
    whole, scanned = (ActiveSplatProtocol(surface_samples=4000, scanned=on).truth(known).points for on in (False, True))
    assert len(whole) == 4000 and 0.3 < len(scanned) / 4000 < 0.8
    places = known.free_space.sample_positions(200, np.random.default_rng(0), min_clearance=0.5, heights=(0.8, 2.0))
    seen = first_viewpoint(known.scene, scanned, places) >= 0
    assert seen.mean() > 0.95  # the same places up to chance
    left = np.array([point for point in whole if np.abs(scanned - point).max(axis=1).min() > 1e-4])
    assert (first_viewpoint(known.scene, left, places) >= 0).mean() < 0.02


def test_a_scene_without_a_place_for_the_scanner_is_refused() -> None:
    with pytest.raises(InputError, match="free"):
        ActiveSplatProtocol(surface_samples=100).truth(GroundTruth(walls(1.0)))


def test_it_needs_the_poses() -> None:
    with pytest.raises(InputError, match="give --poses"):
        SMALL.evaluate(GaussianMap(), SMALL.truth(GroundTruth(walls(1.0))))
    with pytest.raises(InputError, match="image_width"):
        ActiveSplatProtocol(image_width=1)
