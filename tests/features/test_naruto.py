"""NARUTO's volume, targets and goal score by hand, on boxes of free space."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from activestructure_gym.features import FeatureContext, evaluate_features
from activestructure_gym.features.naruto import LISTED, POOL, TARGETS, chosen, find_targets, uncertainty, visible
from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.volume import FREE, OCCUPIED, UNKNOWN, VolumeConfig, VoxelVolume

X = np.array([1.0, 0.0, 0.0])


def box(size: tuple[float, float, float]) -> VoxelVolume:
    """Free inside, occupied in the outermost voxels."""
    volume = VoxelVolume(np.array([[0.0, 0, 0], size]), VolumeConfig())
    volume.state[:] = OCCUPIED
    volume.state[1:-1, 1:-1, 1:-1] = FREE
    volume.weight[:] = 1.0
    return volume


def gaussians(means: np.ndarray, opacities: np.ndarray) -> SimpleNamespace:
    return SimpleNamespace(means=np.reshape(means, (-1, 3)), opacities=np.asarray(opacities, float))


def context(volume: VoxelVolume, positions: list, cloud: SimpleNamespace) -> FeatureContext:
    return FeatureContext(
        mapper=SimpleNamespace(map=cloud), volume=volume, planes=None, camera=PinholeCamera.from_size(40, 24),
        bounds=np.array([[0.0, 0, 0], [4.0, 4, 4]]), coverage_alpha=0.5, max_range=10.0,
        world_from_camera=np.stack([look_along(np.array(p, float), X) for p in positions]),
    )  # fmt: skip


NOTHING = gaussians(np.zeros((0, 3)), np.zeros(0))


def sigma_at(volume: VoxelVolume, cloud: SimpleNamespace, voxel: tuple) -> float:
    voxels, sigma = uncertainty(volume, cloud.means, cloud.opacities)
    (row,) = np.flatnonzero((voxels == voxel).all(axis=1))
    return float(sigma[row])


def test_near_the_surface_are_the_free_voxels_beside_one_that_is_not() -> None:
    volume = box((1.0, 1.0, 1.0))
    volume.state[5, 5, 5] = UNKNOWN
    voxels, sigma = uncertainty(volume, NOTHING.means, NOTHING.opacities)
    assert (volume.state[tuple(voxels.T)] == FREE).all()
    # A shell of 10^3 - 8^3 voxels and the six around the unknown one; nothing was ever seen there.
    assert len(voxels) == 1000 - 512 + 6
    np.testing.assert_array_equal(sigma, 1.0)


def test_sigma_by_hand() -> None:
    volume = box((1.0, 1.0, 1.0))
    wall, front, beyond = (0, 5, 5), (1, 5, 5), (2, 5, 5)
    assert volume.state[wall] == OCCUPIED
    volume.weight[wall], volume.weight[front] = 3.0, 2.0
    cloud = gaussians(volume.center_of(np.array([wall, wall, front])), [0.9, 0.6, 0.5])
    # 3 looks at .9 + .6 behind, 2 looks at .5 in the voxel itself.
    assert sigma_at(volume, cloud, front) == pytest.approx(1 / (1 + 3 * 1.5 + 2 * 0.5))
    # Its neighbour along the wall has the Gaussians of the wall one voxel further on.
    assert sigma_at(volume, cloud, (1, 6, 5)) == pytest.approx(1 / (1 + 3 * 1.5))
    assert sigma_at(volume, cloud, (1, 7, 5)) == 1.0
    # One voxel that stayed unknown lies in front of the wall.
    volume.state[front] = UNKNOWN
    assert sigma_at(volume, cloud, beyond) == pytest.approx(1 / (1 + 3 * 1.5 + 2 * 0.5))
    # Gaussians in free space, away from the surface, say nothing about it; nor do those beyond the grid.
    floater = gaussians([[0.5, 0.5, 0.5], [9.0, 0, 0]], [1.0, 1.0])
    assert uncertainty(volume, floater.means, floater.opacities)[1].min() == 1.0


def test_more_looks_and_more_opacity_leave_less_uncertainty() -> None:
    volume = box((1.0, 1.0, 1.0))
    at = volume.center_of(np.array([0, 5, 5]))
    values = []
    for looks, opacity in ((1, 0.5), (2, 0.5), (2, 0.9)):
        volume.weight[0, 5, 5] = looks
        values.append(sigma_at(volume, gaussians(at, [opacity]), (1, 5, 5)))
    assert values[0] > values[1] > values[2]


def test_targets_are_of_the_most_uncertain_and_the_same_whatever_their_order(rng: np.random.Generator) -> None:
    names, sigma = np.arange(20000) * 7, rng.uniform(0, 1, 20000)
    kept = chosen(names, sigma, 115200)
    assert len(kept) == TARGETS
    pool = np.sort(sigma)[-POOL]
    assert sigma[kept].min() >= pool
    assert (np.diff(sigma[kept]) <= 0).all()
    assert sigma[kept].mean() == pytest.approx((pool + 1) / 2, abs=0.01)  # spread over the pool, not its top
    order = rng.permutation(20000)
    np.testing.assert_array_equal(
        np.sort(names[order][chosen(names[order], sigma[order], 115200)]), np.sort(names[kept])
    )


def test_in_a_small_volume_the_numbers_of_targets_are_shares() -> None:
    # 3.5 % of 10,000 voxels are 350, 7.5 % of these 27.
    assert len(chosen(np.arange(5000), np.ones(5000), 10000)) == 27
    assert len(chosen(np.arange(5), np.ones(5), 10000)) == 5
    assert len(chosen(np.arange(0), np.ones(0), 10000)) == 0


def test_equals_are_spread_over_the_volume() -> None:
    kept = chosen(np.arange(4000), np.ones(4000), 115200)
    assert np.histogram(kept, bins=10, range=(0, 4000))[0].min() > 15


def test_visible_by_hand() -> None:
    volume = box((6.0, 2.0, 2.0))
    volume.state[30, :, :] = UNKNOWN  # a curtain nobody looked behind, at x = 2.95
    here = np.array([[1.05, 1.05, 1.05]])
    targets = here + np.array([[0.45, 0, 0], [0.6, 0, 0], [1.5, 0, 0], [1.95, 0, 0], [0.0, 0.9, 0], [2.05, 0, 0]])
    # Too near; seen; seen; the curtain is in the way of the fourth; seen; too far.
    np.testing.assert_array_equal(visible(volume, here, targets), [[False, True, True, False, True, False]])


def test_goal_score_and_list_by_hand() -> None:
    volume = box((3.0, 2.0, 2.0))
    positions = [[1.05, 1.05, 1.05], [1.05, 1.05, 1.05], [2.55, 1.05, 1.05]]
    ctx = context(volume, positions, gaussians([[0.05, 1.05, 1.05]] * 3, [0.5] * 3))
    targets = ctx.once(find_targets)
    expected = np.zeros(3)
    lists: list[list[int]] = [[], [], []]
    for k, position in enumerate(positions):
        for t, (target, sigma) in enumerate(zip(targets.positions, targets.sigma)):
            distance = np.linalg.norm(target - position)
            if 0.5 < distance < 2.0:  # a convex room: nothing is in the way
                expected[k] += sigma
                lists[k].append(t)
    np.testing.assert_allclose(evaluate_features(("naruto",), ctx)[:, 0], expected, rtol=1e-6)
    assert expected[0] == expected[1] > 0  # the direction plays no part
    names = tuple(f"naruto_look_{rank}_{axis}" for rank in range(LISTED) for axis in "xyz")
    columns = evaluate_features(names, ctx).reshape(3, LISTED, 3)
    for k in range(3):
        np.testing.assert_allclose(columns[k], targets.positions[lists[k][:LISTED]], rtol=1e-6)


def test_behind_the_end_of_the_list_stands_the_candidate_itself() -> None:
    volume = box((3.0, 2.0, 2.0))
    volume.state[:] = FREE
    volume.state[0, 0, 0] = UNKNOWN  # three targets, far from the second candidate
    ctx = context(volume, [[0.05, 0.05, 0.95], [2.95, 1.95, 1.95]], NOTHING)
    seen = ctx.once(find_targets).seen.sum(axis=1)
    assert seen.tolist() == [3, 0]
    names = tuple(f"naruto_look_{rank}_{axis}" for rank in range(LISTED) for axis in "xyz")
    columns = evaluate_features(names, ctx).reshape(2, LISTED, 3)
    own = np.abs(columns - ctx.world_from_camera[:, None, :3, 3]).max(axis=2) < 1e-6
    assert (~own).sum(axis=1).tolist() == [3, 0]
    assert not own[0, :3].any()


def test_targets_far_from_reach_make_every_goal_worthless() -> None:
    """The pathology: all targets go to a large unknown region that nobody can see from up close."""
    volume = box((8.0, 4.0, 4.0))
    walls = volume.center_of(np.argwhere(volume.state == OCCUPIED))
    cloud = gaussians(walls, np.full(len(walls), 0.5))
    near = [[1.05, 2.05, 2.05], [2.05, 2.05, 2.05]]
    # The walls nearby, of one look, are worth going to.
    assert (evaluate_features(("naruto",), context(volume, near, cloud))[:, 0] > 0).all()
    volume.state[50:-1, 1:-1, 1:-1] = UNKNOWN
    volume.state[50:-1:2, 1:-1:2, 1:-1:2] = FREE  # thousands of uncertain voxels, all enclosed
    ctx = context(volume, near, cloud)
    assert ctx.once(find_targets).sigma.min() == 1.0
    np.testing.assert_array_equal(evaluate_features(("naruto",), ctx)[:, 0], 0.0)
