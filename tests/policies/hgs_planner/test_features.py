"""HGS-Planner's coverage along hand-made rays, and its sum with the Fisher term."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from activestructure_gym.features import FeatureContext, evaluate_features
from activestructure_gym.features.information import share_below
from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.policies.hgs_planner.features import RANGE, hgs_coverage
from activestructure_gym.volume import FREE, UNKNOWN, VolumeConfig, VoxelVolume

CAMERA = PinholeCamera.from_size(16, 8, 20.0)  # narrow: all rays are about as long as they are deep


def coverage(depth: float, alpha: float, unknown: tuple[float, float] = (0.0, 9.0)) -> float:
    volume = VoxelVolume(np.array([[-2.0, -2.0, 0.0], [2.0, 2.0, 6.0]]), VolumeConfig())
    centres = volume.origin[2] + (np.arange(volume.shape[2]) + 0.5) * volume.voxel_size
    volume.state[:] = FREE
    volume.state[:, :, (centres > unknown[0]) & (centres < unknown[1])] = UNKNOWN
    image = np.full((1, 8, 16), alpha, np.float32)
    mapper = SimpleNamespace(render_depth_alpha=lambda camera, poses: (np.float32(depth) * image, image))
    context = FeatureContext(
        mapper=mapper, volume=volume, planes=None, camera=CAMERA, bounds=np.zeros((2, 3)), coverage_alpha=0.5,
        max_range=10.0, world_from_camera=np.eye(4)[None],
    )  # fmt: skip
    return hgs_coverage(context)[0]


def test_transmitted_length_in_the_unknown_by_hand() -> None:
    assert coverage(0.0, 0.0) == pytest.approx(1.0, abs=0.01)  # 5 m of nothing known
    assert coverage(2.0, 1.0) == pytest.approx(2 / 5, abs=0.03)  # up to the wall
    assert coverage(2.0, 0.5) == pytest.approx((2 + 0.5 * 3) / 5, abs=0.03)  # half of what is behind it
    assert coverage(2.0, 1.0, unknown=(2.2, 9.0)) == 0.0  # nothing is hidden from a sensor but what is behind
    assert coverage(0.0, 0.0, unknown=(1.0, 2.0)) == pytest.approx(1 / 5, abs=0.03)
    assert coverage(0.0, 0.0, unknown=(7.0, 9.0)) == 0.0


def test_the_more_is_observed_the_more_the_fisher_term_decides(two_walls, looks) -> None:
    names = ("hgs_planner", "hgs_coverage", "fisherrf")
    two_walls.know(UNKNOWN)
    gain, unseen, _ = evaluate_features(names, two_walls.context(*looks)).T
    assert gain == pytest.approx(unseen / unseen.max()) and gain.argmax() == 2
    two_walls.know(FREE)
    gain, unseen, fisher, raw = evaluate_features((*names, "hgs_planner_raw"), two_walls.context(*looks)).T
    assert unseen.max() == 0.0 and gain == pytest.approx(share_below(fisher)) and gain.argmax() == fisher.argmax() == 1
    assert raw == pytest.approx(fisher, rel=1e-5)  # lambda_o is 1


def test_the_raw_sum_counts_the_volume_of_voxels_on_all_rays(two_walls, looks) -> None:
    two_walls.know(UNKNOWN)
    raw, unseen = evaluate_features(("hgs_planner_raw", "hgs_coverage"), two_walls.context(*looks)).T
    camera, size = two_walls.context(*looks).camera, two_walls.volume.voxel_size
    reach = min(RANGE, two_walls.context(*looks).max_range)
    voxels = reach / size * camera.width * camera.height  # along all rays
    assert raw * two_walls.mapper.map.count == pytest.approx(unseen * voxels * size**3, rel=1e-5)  # lambda_o is 0


def test_the_shell_in_front_of_a_wall_that_was_seen_holds_nothing_unseen(two_walls, looks) -> None:
    east, _, north = hgs_coverage(two_walls.context(*looks))
    assert (two_walls.volume.state == UNKNOWN).any()
    assert east < 0.04 < 0.2 < north
