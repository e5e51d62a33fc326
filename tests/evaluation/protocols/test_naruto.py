"""The evaluation of NARUTO: the surface of the map, culled to what frames see of it, against the mesh."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.protocols import NarutoProtocol
from activestructure_gym.evaluation.protocols.activesplat import SampledTruth
from activestructure_gym.evaluation.protocols.naruto import _merged
from activestructure_gym.geometry import invert_rigid, look_along, transform_points
from activestructure_gym.ground_truth import GroundTruth
from activestructure_gym.mapping import GaussianMap
from activestructure_gym.scenes.raycaster import RayCaster
from tests.evaluation.protocols.test_activesplat import AHEAD, path_of, walls

SMALL = NarutoProtocol(samples=4000, scanned=False, image_width=64)


def triangles_of(*distances: float) -> np.ndarray:  # [T, 3, 3]
    mesh = walls(*distances, cells=20).mesh
    return mesh.vertices[mesh.faces].astype(np.float64)


class Given(NarutoProtocol):
    """Measure given triangles instead of the surface of a map."""

    triangles = np.zeros((0, 3, 3))

    def surface(self, gaussians, path):
        return self.triangles


def measured(triangles: np.ndarray, truth: SampledTruth, *frames: np.ndarray) -> dict:
    protocol = Given(samples=4000, image_width=64)
    object.__setattr__(protocol, "triangles", triangles)
    return protocol.evaluate(GaussianMap(), truth, path_of(*frames))


def test_what_no_frame_sees_of_the_surface_is_cut_away() -> None:
    kept = SMALL.culled(triangles_of(1.0, 1.02, 1.5), path_of(AHEAD))[:, 0, 0].round(3)
    # The second wall is 2 cm behind the first: within the tolerance of 3 cm. The third is hidden.
    assert set(kept) == {1.0, 1.02} and min(np.sum(kept == 1.0), np.sum(kept == 1.02)) > 700
    away = look_along(np.zeros(3), np.array([-1.0, 0.0, 0.0]))
    assert not len(SMALL.culled(triangles_of(1.0), path_of(away)))
    behind = look_along(np.array([3.0, 0.0, 0.0]), np.array([-1.0, 0.0, 0.0]))
    assert set(SMALL.culled(triangles_of(1.0, 1.5), path_of(AHEAD, AHEAD, behind))[:, 0, 0]) == {1.0, 1.5}
    # Every second frame alone counts.
    assert set(SMALL.culled(triangles_of(1.0, 1.5), path_of(AHEAD, behind))[:, 0, 0]) == {1.0}


def test_a_triangle_with_one_corner_in_sight_stays() -> None:
    ends = np.array([[1.0, 9.0, 0.0], [1.0, 0.0, 9.0], [1.0, -9.0, 0.0], [1.0, 0.0, -9.0]])
    large = np.stack([np.tile([1.0, 0.0, 0.0], (4, 1)), ends, np.roll(ends, 1, axis=0)], axis=1)
    assert len(SMALL.culled(large, path_of(AHEAD))) == 4
    assert not len(SMALL.culled(large + [0.0, 2.0, 2.0], path_of(AHEAD)))


def test_the_numbers_are_those_of_two_sampled_meshes() -> None:
    truth = SMALL.truth(GroundTruth(walls(1.0, 5.0)))
    found = measured(triangles_of(1.02), truth, AHEAD)
    # Half of the truth is 2 cm from the surface, the other half 3.98 m. All of the surface is near the truth.
    assert found["completion_ratio"] == 50.0 and found["precision"] == 100.0
    assert found["accuracy_cm"] == pytest.approx(2.0, abs=0.4)
    assert found["completion_cm"] == pytest.approx((2.0 + 398.0) / 2, abs=0.3)
    assert found["area_m2"] == pytest.approx(1.0)


def test_hidden_truth_counts_unlike_in_standard() -> None:
    truth = SMALL.truth(GroundTruth(walls(1.0, 1.5)))  # nobody in front of the first wall sees the second one
    assert measured(triangles_of(1.0), truth, AHEAD)["completion_ratio"] == 50.0


def test_the_surface_of_a_map_is_fused_at_its_keyframes() -> None:
    block = np.zeros((14, 2500))
    spots = np.linspace(-0.5, 0.5, 50)
    block[0] = 1.0
    block[1], block[2] = (axis.ravel() for axis in np.meshgrid(spots, spots))
    block[3] = 1.0
    block[7:10] = np.log([[0.02], [0.02], [0.02]])
    block[10] = 5.0
    gaussians = GaussianMap()
    gaussians.append(block.astype(np.float32))
    path = path_of(AHEAD)
    truth = SMALL.truth(GroundTruth(walls(1.0)))
    found = SMALL.evaluate(gaussians, truth, path)
    assert found["precision"] > 99.0 and found["completion_ratio"] > 99.0 and found["accuracy_cm"] < 3.0
    surface = SMALL.surface(gaussians, path).reshape(-1, 3)
    assert cKDTree(surface).query(truth.points)[0].max() < 0.1


def test_a_map_without_a_surface_is_measured_too() -> None:
    found = SMALL.evaluate(GaussianMap(), SMALL.truth(GroundTruth(walls(1.0))), path_of(AHEAD))
    assert found["completion_ratio"] == 0.0 and found["accuracy_cm"] is None and found["notes"]["naruto"]
    with pytest.raises(InputError, match="give --poses"):
        SMALL.evaluate(GaussianMap(), SMALL.truth(GroundTruth(walls(1.0))))


def test_the_corners_that_frames_see_are_those_of_whole_depth_images() -> None:
    rng = np.random.default_rng(0)
    centres = np.column_stack([rng.uniform(0.5, 3.0, 60), rng.uniform(-1.0, 1.0, (60, 2))])
    triangles = centres[:, None] + rng.uniform(-0.4, 0.4, (60, 3, 3))
    path = path_of(
        *(look_along(rng.uniform(-0.3, 0.3, 3), np.array([1.0, side, 0.0])) for side in (-0.4, 0.0, 0.4, 0.8))
    )
    camera = path.camera.resized(64, round(64 * path.camera.height / path.camera.width))
    caster = RayCaster(triangles.reshape(-1, 3), np.arange(180).reshape(-1, 3))
    seen = np.zeros(180, bool)
    for pose in path.all_poses[:: SMALL.every]:
        depth = caster.cast(pose[:3, 3], camera.rays().reshape(-1, 3) @ pose[:3, :3].T).distance
        depth = np.where(depth <= SMALL.farthest_m, depth, 0.0).reshape(camera.height, camera.width)
        points = transform_points(invert_rigid(pose), triangles.reshape(-1, 3))
        for number, (x, y, z) in enumerate(points):
            u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
            if z > 0 and 0 <= u < camera.width and 0 <= v < camera.height:
                seen[number] |= z < depth[int(v), int(u)] + SMALL.behind_m
    expected = triangles[seen.reshape(-1, 3).any(axis=1)]
    assert 10 < len(expected) < 55
    np.testing.assert_array_equal(SMALL.culled(triangles, path), expected)


def test_equal_corners_of_triangles_are_one() -> None:
    triangles = np.random.default_rng(0).integers(0, 4, (200, 3, 3)) * 0.02
    corners, faces = _merged(triangles)
    assert len(corners) == len(np.unique(triangles.reshape(-1, 3), axis=0))
    assert np.array_equal(corners[faces], triangles)
    assert len(_merged(np.array([[[0.0, 1.0, 2.0], [-0.0, 1.0, 2.0], [0.0, -1.0, 2.0]]]))[0]) == 2  # -0.0 equals 0.0
