"""The candidate pool: who enters, who leaves, and that the draw is neutral."""

from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.geometry import look_along
from activestructure_gym.views import CandidatePool, ViewConfig

BOUNDS = np.array([[0.0, 0.0, 0.0], [4.0, 3.0, 2.5]])
ANCHOR = np.array([1.1, 1.15, 1.3])
NO_REVISITS = np.zeros((0, 4, 4))


class OpenSpace:
    """Everything inside the bounds is free; clearance is the distance to the box."""

    def clearance_at(self, points: np.ndarray) -> np.ndarray:
        return np.minimum(points - BOUNDS[0], BOUNDS[1] - points).min(axis=1)


class Straight:
    """Path length is the straight distance; beyond ``reach`` nothing is reachable."""

    def __init__(self, start: np.ndarray, reach: float = np.inf) -> None:
        self.start, self.reach = start, reach

    def at(self, points: np.ndarray) -> np.ndarray:
        length = np.linalg.norm(points - self.start, axis=1)
        return np.where(length <= self.reach, length, np.inf).astype(np.float32)


def pool_and_offer(config: ViewConfig, step: int = 0, reach: float = np.inf, seed: int = 0):
    pool = CandidatePool(ANCHOR, BOUNDS, config, seed)
    return pool, pool.offer(OpenSpace(), Straight(ANCHOR, reach), step, NO_REVISITS)


def test_lattice_by_hand() -> None:
    config = ViewConfig(heights_m=(0.0,), directions=3, max_candidates=1000, max_revisits=0)
    pool, table = pool_and_offer(config)
    # x = 0.1, 0.6 .. 3.6 and y = 0.15, 0.65 .. 2.65 around the anchor; a clearance of 0.3 m cuts both ends.
    xs = np.unique(table.world_from_camera[:, 0, 3].round(6))
    ys = np.unique(table.world_from_camera[:, 1, 3].round(6))
    np.testing.assert_allclose(xs, np.arange(0.6, 3.61, 0.5))
    np.testing.assert_allclose(ys, [0.65, 1.15, 1.65, 2.15, 2.65])
    assert len(table) == 7 * 5 * 3
    assert len(np.unique(table.ids)) == len(table)
    np.testing.assert_allclose(
        table.path_length, np.linalg.norm(table.world_from_camera[:, :3, 3] - ANCHOR, axis=1), rtol=1e-6
    )


def test_turning_on_the_spot_is_offered() -> None:
    config = ViewConfig(directions=15, max_candidates=5000, max_revisits=0)
    _, table = pool_and_offer(config)
    here = np.linalg.norm(table.world_from_camera[:, :3, 3] - ANCHOR, axis=1) < 1e-9
    assert here.sum() == 15
    assert (table.path_length[here] == 0).all()


def test_ids_persist_and_out_of_reach_views_wait() -> None:
    config = ViewConfig(directions=2, max_candidates=5000, max_revisits=0)
    pool, near = pool_and_offer(config, reach=1.0)
    later = pool.offer(OpenSpace(), Straight(ANCHOR), 1, NO_REVISITS)
    assert len(near) < len(later)
    assert set(near.ids) < set(later.ids)
    where = {i: pose for i, pose in zip(later.ids, later.world_from_camera)}
    for i, pose in zip(near.ids, near.world_from_camera):
        np.testing.assert_array_equal(pose, where[i])


def test_visited_and_dropped_views_leave_for_good() -> None:
    config = ViewConfig(directions=15, max_candidates=5000, max_revisits=0)
    pool, table = pool_and_offer(config)
    before = len(pool)
    visited = table.world_from_camera[40].copy()
    # 0.2 m and 5 degrees away is a visit; the neighbours 0.5 m away and the other directions stay.
    visited[:3, 3] += [0.2, 0.0, 0.0]
    direction = visited[:3, 2] + np.tan(np.radians(5.0)) * visited[:3, 0]
    pool.mark_visited(look_along(visited[:3, 3], direction))
    assert len(pool) == before - 1
    pool.drop(int(table.ids[41]))
    pool.drop(-1)  # a revisit is not part of the pool
    after = pool.offer(OpenSpace(), Straight(ANCHOR), 1, NO_REVISITS)
    assert set(table.ids) - set(after.ids) == {table.ids[40], table.ids[41]}


def test_a_view_is_visited_from_itself_at_an_angle_of_nothing() -> None:
    config = ViewConfig(directions=15, max_candidates=5000, max_revisits=0, visited_angle_deg=0.0)
    pool, table = pool_and_offer(config)
    before = len(pool)
    for pose in table.world_from_camera[:15]:
        pool.mark_visited(pose)
    assert len(pool) == before - 15


def test_half_of_a_small_table_is_for_new_views() -> None:
    pool, _ = pool_and_offer(ViewConfig(directions=15, max_candidates=5000, max_revisits=4))
    poses = np.stack([look_along(ANCHOR, [1.0, 0.1 * k, 0.0]) for k in range(4)])
    for room, revisits in ((1, 0), (4, 2), (7, 3), (8, 4), (40, 4)):
        table = pool.offer(OpenSpace(), Straight(ANCHOR), 1, poses, room=room)
        assert (len(table), table.revisit.sum()) == (room, revisits)


def test_draw_spreads_over_positions_and_ignores_everything_but_seed_and_step() -> None:
    config = ViewConfig(directions=15, max_candidates=60, max_revisits=0)
    _, table = pool_and_offer(config)
    assert len(table) == 60
    positions = np.unique(table.world_from_camera[:, :3, 3].round(6), axis=0)
    assert len(positions) == 60  # there are more than 60 positions: none comes twice
    _, again = pool_and_offer(config)
    np.testing.assert_array_equal(table.ids, again.ids)
    assert set(pool_and_offer(config, step=1)[1].ids) != set(table.ids)
    assert set(pool_and_offer(config, seed=1)[1].ids) != set(table.ids)


def test_draw_takes_a_second_view_only_after_a_first_of_every_position() -> None:
    config = ViewConfig(directions=15, max_candidates=200, max_revisits=0, heights_m=(0.0,))
    pool, table = pool_and_offer(config)
    _, counts = np.unique(table.world_from_camera[:, :3, 3].round(6), axis=0, return_counts=True)
    assert len(counts) == 35
    assert counts.max() - counts.min() <= 1
    # Over many steps every view is drawn about equally often: 200 of 525 per step.
    drawn = np.zeros(len(pool), int)
    for step in range(200):
        drawn[pool.offer(OpenSpace(), Straight(ANCHOR), step, NO_REVISITS).ids] += 1
    drawn = drawn[drawn > 0]
    assert len(drawn) == 525
    expected = 200 * 200 / 525
    assert abs(drawn.mean() - expected) < 1e-9
    assert drawn.std() < 2 * np.sqrt(expected)


def test_revisits_stand_last_and_are_not_taken_out_by_visits() -> None:
    config = ViewConfig(directions=2, max_candidates=20, max_revisits=3)
    pool = CandidatePool(ANCHOR, BOUNDS, config, 0)
    keyframes = np.stack([look_along(ANCHOR + [0.1 * i, 0, 0], np.array([1.0, 0, 0])) for i in range(5)])
    pool.mark_visited(keyframes[0])
    table = pool.offer(OpenSpace(), Straight(ANCHOR), 0, keyframes)
    assert len(table) == 20
    np.testing.assert_array_equal(table.revisit, [False] * 17 + [True] * 3)
    np.testing.assert_array_equal(table.world_from_camera[17:], keyframes[:3])
    assert (table.ids[17:] == -1).all()


def test_views_are_upright() -> None:
    _, table = pool_and_offer(ViewConfig(max_revisits=0))
    assert (np.abs(table.world_from_camera[:, 2, 0]) < 1e-12).all()  # the image's right is level
    assert (table.world_from_camera[:, 2, 1] < 0).all()  # and its down points down


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"lattice_step_m": 0.0}, "lattice_step_m"),
        ({"heights_m": ()}, "at least one number"),
        ({"directions": 0}, "directions must be a whole number from 1 to 1000"),
        ({"max_candidates": 4, "max_revisits": 4}, "below max_candidates"),
        ({"scoring_scale": 1.5}, "scoring_scale"),
        ({"coverage_alpha": 1.0}, "coverage_alpha"),
    ],
)
def test_configuration_is_checked(options: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        ViewConfig(**options)
