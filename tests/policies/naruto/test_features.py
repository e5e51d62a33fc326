"""NARUTO's volume, targets and goal score by hand, on boxes of free space."""

from __future__ import annotations

from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest

from activestructure_gym.features import FeatureContext, evaluate_features
from activestructure_gym.features.voxel_errors import squared_depth_error, voxel_sums
from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.policies.naruto.features import (
    FLOOR,
    INITIAL,
    LISTED,
    LOOKS,
    POOL,
    TARGETS,
    chosen,
    find_targets,
    learned_uncertainty,
    looked_at,
    uncertainty,
    visible,
)
from activestructure_gym.sensors import Frame
from activestructure_gym.volume import FREE, OCCUPIED, UNKNOWN, VolumeConfig, VoxelVolume

X = np.array([1.0, 0.0, 0.0])


def box(size: tuple[float, float, float]) -> VoxelVolume:
    """Free inside, occupied in the outermost voxels."""
    volume = VoxelVolume(np.array([[0.0, 0, 0], size]), VolumeConfig())
    volume.state[:] = OCCUPIED
    volume.state[1:-1, 1:-1, 1:-1] = FREE
    volume.weight[:] = 1.0
    return volume


class Shown(NamedTuple):
    """Keyframes and what the map shows of each: the errors that the uncertainty is learnt from."""

    keyframes: list[Frame]
    depths: list[np.ndarray]

    def render(self, camera: PinholeCamera, pose: np.ndarray) -> SimpleNamespace:
        row = next(i for i, frame in enumerate(self.keyframes) if frame.world_from_camera is pose)
        depth = self.depths[row]
        return SimpleNamespace(depth=0.5 * depth, alpha=np.full_like(depth, 0.5), color=None)


CAMERA = PinholeCamera(1, 1, 1.0, 1.0, 0.5, 0.5)  # one pixel, straight ahead


def look(eye: list, direction: list, measured: float, shown: float) -> tuple[Frame, np.ndarray]:
    pose = look_along(np.array(eye, float), np.array(direction, float))
    depth = np.full((1, 1), measured, np.float32)
    return Frame(np.zeros((1, 1, 3), np.uint8), depth, pose, CAMERA), np.full((1, 1), shown, np.float32)


def mapper(*looks: tuple[Frame, np.ndarray]) -> Shown:
    return Shown([frame for frame, _ in looks], [depth for _, depth in looks])


def context(volume: VoxelVolume, positions: list, shown: Shown) -> FeatureContext:
    return FeatureContext(
        mapper=shown, volume=volume, planes=None, camera=PinholeCamera.from_size(40, 24),
        bounds=np.array([[0.0, 0, 0], [4.0, 4, 4]]), coverage_alpha=0.5, max_range=10.0,
        world_from_camera=np.stack([look_along(np.array(p, float), X) for p in positions]),
    )  # fmt: skip


NOTHING = mapper()


def sigma_at(volume: VoxelVolume, shown: Shown, voxel: tuple) -> float:
    voxels, sigma, _ = uncertainty(volume, *voxel_sums(shown, volume, squared_depth_error))
    (row,) = np.flatnonzero((voxels == voxel).all(axis=1))
    return float(sigma[row])


def test_near_the_surface_are_the_free_voxels_beside_one_that_is_not() -> None:
    volume = box((1.0, 1.0, 1.0))
    volume.state[volume.state == OCCUPIED] = UNKNOWN
    volume.state[5, 5, 5] = UNKNOWN
    none = np.zeros(volume.shape)
    voxels, sigma, _ = uncertainty(volume, none, none)
    assert (volume.state[tuple(voxels.T)] == FREE).all()
    # A shell of 10^3 - 8^3 voxels and the six around the unknown one; nothing was ever seen there.
    assert len(voxels) == 1000 - 512 + 6
    np.testing.assert_array_equal(sigma, INITIAL)
    assert pytest.approx(3.0586, abs=1e-4) == INITIAL


def test_sigma_by_hand() -> None:
    volume = box((1.0, 1.0, 1.0))
    eye = volume.center_of(np.array([8, 5, 5])).tolist()
    depth = 0.75  # to the middle of voxel (0, 5, 5), less half of one
    wrong = mapper(look(eye, [-1, 0, 0], depth, depth + 0.3), look(eye, [-1, 0, 0], depth, depth - 0.4))
    assert sigma_at(volume, wrong, (1, 5, 5)) == pytest.approx(0.5 * (0.3**2 + 0.4**2))
    # The mean of all pixels holds for the rest of the wall, too.
    assert sigma_at(volume, wrong, (1, 6, 5)) == pytest.approx(0.125)
    assert sigma_at(volume, wrong, (1, 7, 5)) == pytest.approx(0.125)
    # One voxel that stayed unknown lies in front of the wall.
    volume.state[1, 5, 5] = UNKNOWN
    assert sigma_at(volume, wrong, (2, 5, 5)) == pytest.approx(0.125)
    # Right to a centimetre: the least there is.
    assert sigma_at(volume, mapper(look(eye, [-1, 0, 0], depth, depth + 0.01)), (2, 5, 5)) == FLOOR


def test_every_measured_place_has_the_mean_error_of_all_pixels() -> None:
    """[naruto, code] fits each ray to the mean of the batch: errors 0.0004 and 0.5 make it 0.25 at both."""
    volume = box((2.0, 2.0, 2.0))
    volume.state[:, 0] = UNKNOWN  # a wall that was not measured
    eye = volume.center_of(np.array([10, 10, 10])).tolist()
    good, bad = look(eye, [-1, 0, 0], 0.95, 0.95 + 0.0004**0.5), look(eye, [1, 0, 0], 1.1, 1.1 + 0.5**0.5)
    shown = mapper(good, bad)
    for voxel in ((1, 10, 10), (20, 10, 10)):
        assert sigma_at(volume, shown, voxel) == pytest.approx(0.2502, rel=1e-5)
    assert sigma_at(volume, shown, (10, 1, 10)) == INITIAL
    assert sigma_at(volume, mapper(good, good), (1, 10, 10)) == FLOOR


def test_a_measured_place_is_never_settled_however_large_its_error() -> None:
    volume = box((2.0, 2.0, 2.0))
    eye = volume.center_of(np.array([10, 10, 10])).tolist()
    wrong = look(eye, [-1, 0, 0], 0.95, 2.95)
    voxels, sigma = learned_uncertainty(mapper(wrong, wrong), volume)
    (row,) = np.flatnonzero((voxels == (1, 10, 10)).all(axis=1))
    assert sigma[row] == pytest.approx(4.0) and sigma[row] > INITIAL


def test_targets_are_of_the_most_uncertain_and_the_same_whatever_their_order(rng: np.random.Generator) -> None:
    names, sigma = np.arange(20000) * 7, rng.uniform(0, 1, 20000)
    kept = chosen(names, sigma, 132192, 0)
    assert len(kept) == TARGETS
    pool = np.sort(sigma)[-POOL]
    assert sigma[kept].min() >= pool
    assert (np.diff(sigma[kept]) <= 0).all()
    assert sigma[kept].mean() == pytest.approx((pool + 1) / 2, abs=0.01)  # spread over the pool, not its top
    order = rng.permutation(20000)
    np.testing.assert_array_equal(
        np.sort(names[order][chosen(names[order], sigma[order], 132192, 0)]), np.sort(names[kept])
    )


def test_in_a_small_volume_the_numbers_of_targets_are_shares() -> None:
    # 3.026 % of 10,000 voxels are 302.6, so the pool has 303. 7.5 % of these are 22.7.
    assert len(chosen(np.arange(5000), np.ones(5000), 10000, 0)) == 23
    assert len(chosen(np.arange(5), np.ones(5), 10000, 0)) == 5
    assert len(chosen(np.arange(0), np.ones(0), 10000, 0)) == 0


def test_equals_are_spread_over_the_volume() -> None:
    kept = chosen(np.arange(4000), np.ones(4000), 132192, 0)
    assert np.histogram(kept, bins=10, range=(0, 4000))[0].min() > 15


def test_uncertain_places_have_their_even_share_of_the_targets() -> None:
    # 3.026 % of 76,670 voxels are a pool of 2,320, and 7.5 % of these are 174 targets. The even share of 12 is 0.9.
    sigma = np.where(np.arange(7600) % 633 == 5, INITIAL, FLOOR)
    assert (sigma == INITIAL).sum() == 12
    kept = [chosen(np.arange(7600), sigma, 76670, keyframes) for keyframes in range(400)]
    assert len(kept[0]) == 174
    shares = [(sigma[rows] == INITIAL).sum() for rows in kept]
    assert np.mean(shares) == pytest.approx(12 * 174 / 2320, abs=0.15)


def test_the_targets_change_with_the_keyframes() -> None:
    """A voxel that is no target now can be one later, as long as the pool stays the same."""
    kept = [set(chosen(np.arange(4000), np.ones(4000), 132192, keyframes)) for keyframes in range(60)]
    assert len(set.union(*kept)) > 0.98 * 4000  # 1 - 0.925^60
    assert 5 < len(kept[0] & kept[1]) < 45  # 300 x 7.5 % by chance


def test_an_unmeasured_place_that_two_keyframes_saw_is_settled() -> None:
    volume = box((4.0, 2.0, 2.0))
    volume.state[20, 10, 10] = UNKNOWN  # never resolved: no ray ends there
    place = volume.center_of(np.array([20, 10, 10]))
    wide = PinholeCamera.from_size(40, 24)

    def seen_from(x: float, direction: float) -> Frame:
        pose = look_along(np.array([x, place[1], place[2]]), np.array([direction, 0.0, 0.0]))
        return Frame(np.zeros((24, 40, 3), np.uint8), np.zeros((24, 40), np.float32), pose, wide)

    near, far, away = seen_from(place[0] - 1.0, 1.0), seen_from(place[0] - 2.1, 1.0), seen_from(place[0] - 1.0, -1.0)
    assert looked_at([near], volume, place[None]).tolist() == [1]
    assert looked_at([near, near, near], volume, place[None]).tolist() == [LOOKS]
    assert looked_at([far, away], volume, place[None]).tolist() == [0]
    volume.state[14] = OCCUPIED  # a wall in between
    assert looked_at([near], volume, place[None]).tolist() == [0]


def test_a_place_that_stays_unknown_is_no_trap() -> None:
    volume = box((4.0, 2.0, 2.0))
    volume.state[20, 10, 10] = UNKNOWN
    place = volume.center_of(np.array([20, 10, 10]))
    wide = PinholeCamera.from_size(40, 24)
    pose = look_along(place - [1.0, 0.0, 0.0], X)
    frame = Frame(np.zeros((24, 40, 3), np.uint8), np.full((24, 40), 3.0, np.float32), pose, wide)
    depth = np.full((24, 40), 3.0, np.float32)
    for looks, expected in ((1, INITIAL), (2, FLOOR)):
        voxels, sigma = learned_uncertainty(Shown([frame] * looks, [depth] * looks), volume)
        beside = np.abs(voxels - [20, 10, 10]).sum(axis=1) == 1
        assert beside.sum() == 6 and (sigma[beside] == expected).all()


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
    volume.state[0] = UNKNOWN  # nobody looked at one of the walls
    ctx = context(volume, positions, mapper(look([1.05, 1.05, 1.05], [1, 0, 0], 1.9, 2.4)))
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
        listed = targets.positions[lists[k][:LISTED]]
        np.testing.assert_allclose(columns[k][: len(listed)], listed, rtol=1e-6)


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
    cloud = mapper(look([1.05, 2.05, 2.05], [-1, 0, 0], 1.0, 1.0))
    near = [[1.05, 2.05, 2.05], [2.05, 2.05, 2.05]]
    # The walls nearby, well rendered, are worth going to.
    assert (evaluate_features(("naruto",), context(volume, near, cloud))[:, 0] > 0).all()
    volume.state[50:-1, 1:-1, 1:-1] = UNKNOWN
    volume.state[50:-1:2, 1:-1:2, 1:-1:2] = FREE  # thousands of uncertain voxels, all enclosed
    ctx = context(volume, near, cloud)
    assert ctx.once(find_targets).sigma.min() == INITIAL
    np.testing.assert_array_equal(evaluate_features(("naruto",), ctx)[:, 0], 0.0)
