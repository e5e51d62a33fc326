"""Unknown space opened by views and ways: laws, a slow oracle, and an episode."""

from __future__ import annotations

import itertools
import math
import sys
from typing import Any

import numpy as np
import pytest
from scipy import ndimage

from activestructure_gym import Reconstruction, configure, ground_truth_of, load_scene
from activestructure_gym.features import FeatureContext
from activestructure_gym.features.unknown_volume import (
    MEAN_DEPTH,
    REACH,
    SHORTLIST,
    _dilated,
    opened_volume,
    target_voxels,
    unknown_volume,
)
from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.volume import FREE, OCCUPIED, VolumeConfig, VoxelVolume

NARROW = PinholeCamera.from_size(12, 8, 40.0)
EAST = look_along(np.zeros(3), np.array([1.0, 0, 0]))


def volume(size: float = 3.0) -> VoxelVolume:
    return VoxelVolume(np.array([[-size] * 3, [size] * 3]), VolumeConfig())


def context(space: VoxelVolume, *poses: np.ndarray, **changes: Any) -> FeatureContext:
    options: dict[str, Any] = {
        "mapper": None,
        "volume": space,
        "planes": None,
        "camera": NARROW,
        "bounds": np.array([[-3.0] * 3, [3.0] * 3]),
        "coverage_alpha": 0.5,
        "max_range": 10.0,
        "world_from_camera": np.array(poses),
    }
    return FeatureContext(**{**options, **changes})


def alone(space: VoxelVolume, *poses: np.ndarray) -> np.ndarray:
    return opened_volume(context(space), np.array(poses), np.arange(len(poses) + 1))


def together(space: VoxelVolume, *poses: np.ndarray) -> float:
    return float(opened_volume(context(space), np.array(poses), np.array([0, len(poses)]))[0])


def by_the_definition(space: VoxelVolume, *poses: np.ndarray) -> float:
    """The same sum in plain Python, ray by ray, from a table of the best chance of every voxel."""
    size, wanted = space.voxel_size, target_voxels(context(space))
    best: dict[tuple[int, ...], float] = {}
    for pose, row, column in itertools.product(poses, range(NARROW.height), range(NARROW.width)):
        ray = pose[:3, :3] @ NARROW.rays()[row, column].astype(np.float64)
        ray /= np.linalg.norm(ray)
        inside = 0.0
        for step in range(1, int(REACH / (0.5 * size)) + 1):
            voxel = tuple(np.floor((pose[:3, 3] + 0.5 * size * step * ray - space.origin) / size).astype(int).tolist())
            if any(not 0 <= v < n for v, n in zip(voxel, space.shape)) or space.state[voxel] == OCCUPIED:
                break
            chance = math.exp(-inside / MEAN_DEPTH)
            if chance < 0.02:
                break
            if wanted[voxel]:
                best[voxel] = max(best.get(voxel, 0.0), chance)
                inside += 0.5 * size
    return sum(best.values()) * size**3


def test_sum_of_the_best_chances_by_its_definition() -> None:
    rng = np.random.default_rng(0)
    space = volume()
    space.state[:] = rng.choice([0, FREE, OCCUPIED], size=space.shape, p=[0.5, 0.48, 0.02])
    poses = [look_along(rng.uniform(-1, 1, 3), rng.normal(size=3)) for _ in range(3)]
    for pose in poses:
        assert alone(space, pose)[0] == pytest.approx(by_the_definition(space, pose), rel=1e-4)
    assert together(space, *poses) == pytest.approx(by_the_definition(space, *poses), rel=1e-4)


def test_a_voxel_counts_once_however_often_it_is_met() -> None:
    space, west = volume(), look_along(np.zeros(3), np.array([-1.0, 0, 0]))
    one, other = alone(space, EAST, west)
    assert one > 0.1
    assert together(space, EAST, EAST) == one
    assert together(space, EAST, west) == pytest.approx(one + other, rel=0.01)  # they share what is around the eye
    turned = look_along(np.zeros(3), np.array([1.0, 0.3, 0]))
    assert one < together(space, EAST, turned) < one + alone(space, turned)[0]


def test_nothing_behind_a_wall_and_nothing_in_what_is_known() -> None:
    space = volume()
    before = alone(space, EAST)[0]
    space.state[40] = OCCUPIED  # 1 m ahead
    near = alone(space, EAST)[0]
    assert 0 < near < 0.5 * before
    space.state[:40] = FREE
    assert alone(space, EAST)[0] == 0.0


def test_what_was_looked_through_counts_only_away_from_what_is_occupied() -> None:
    space = volume()
    space.weight[:], space.tsdf[:] = 1.0, 1.0  # nothing is unobserved, and nothing is proven free
    assert not space.unobserved.any()
    assert alone(space, EAST)[0] > 0.1
    space.state[20, 20, 20] = OCCUPIED
    wanted = target_voxels(context(space))
    assert (~wanted).sum() == 5**3 and not wanted[18:23, 18:23, 18:23].any()
    space.state[wanted] = FREE
    assert alone(space, EAST)[0] == 0.0  # the shell of the occupied voxel stays, and is worth nothing


@pytest.mark.parametrize("shape", [(9, 12, 7), (1, 2, 20), (3, 3, 3)])
def test_targets_keep_away_from_what_is_occupied_as_a_maximum_filter_does(shape: tuple[int, ...]) -> None:
    mask = np.random.default_rng(0).random(shape) < 0.02
    mask.flat[-1] = True
    np.testing.assert_array_equal(_dilated(mask), ndimage.maximum_filter(mask, size=5))


def test_threads_do_not_matter(monkeypatch: pytest.MonkeyPatch) -> None:
    space, rng = volume(), np.random.default_rng(1)
    space.state[:] = rng.choice([0, FREE, OCCUPIED], size=space.shape, p=[0.5, 0.49, 0.01])
    poses = [look_along(rng.uniform(-1, 1, 3), rng.normal(size=3)) for _ in range(20)]
    found = []
    for threads in (1, 4):
        monkeypatch.setattr(sys.modules[opened_volume.__module__], "default_threads", lambda n=threads: n)
        found.append(alone(space, *poses))
    np.testing.assert_array_equal(*found)


@pytest.fixture(scope="module")
def episode() -> Reconstruction:
    config = configure(
        "fast", {"frame_budget": 60, "features": ("unknown_volume",), "views.max_candidates": 128, "keyframe_every": 5}
    )
    episode = Reconstruction(config)
    episode.start(ground_truth_of(load_scene("apartment?rooms=2&seed=1")), seed=0)
    return episode


def test_ways_of_the_shortlist_show_at_least_what_their_ends_show(episode: Reconstruction) -> None:
    here, way = episode.features.T
    looked = way > 0
    assert len(here) > SHORTLIST and looked.sum() <= SHORTLIST
    assert (way[looked] >= here[looked] * (1 - 1e-6)).all() and (way[looked] > 1.2 * here[looked]).any()
    discount = 1 / (1 + episode.agent.least_frames(episode.candidates.world_from_camera) / 5)
    assert (here * discount)[looked].min() >= (here * discount)[~looked].max()


def test_the_walk_that_was_looked_along_leaves_less_unknown(episode: Reconstruction) -> None:
    row = int(episode.features[:, 1].argmax())
    foretold = float(episode.features[row, 1])
    before = np.count_nonzero(episode.volume.unobserved)
    episode.move_to(row)
    opened = (before - np.count_nonzero(episode.volume.unobserved)) * episode.volume.voxel_size**3
    assert opened > 0.2 * foretold


def test_nobody_who_walks_has_no_ways() -> None:
    space = volume()
    values = unknown_volume(context(space, EAST))
    assert values.shape == (1, 2) and values[0, 0] == alone(space, EAST)[0] and values[0, 1] == 0.0
    assert unknown_volume(context(space, world_from_camera=np.zeros((0, 4, 4)))).shape == (0, 2)
