"""Closed-loop FisherRF: the formula worked out again, and what a look on the way takes from the next."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from activestructure_gym.features.fisherrf import KINDS, TIMES, fisherrf
from activestructure_gym.features.information import LAMBDA, diagonal_units
from activestructure_gym.motion import PlannedPath
from activestructure_gym.policies.fisherrf.features import (
    END_WEIGHT,
    HORIZON,
    fisherrf_path,
    information_along,
    log_of_path,
)
from activestructure_gym.splatting.fisher import view_information


def walker(ways: list) -> SimpleNamespace:
    """An agent with these ways to the views that it is asked for, by the view's pose."""
    return SimpleNamespace(pose=np.eye(4), paths=lambda volume, goals: [ways[goal.tobytes()] for goal in goals])


def context_of(two_walls, looks, through: list):
    """The views with a way through the given poses to each; None for no way."""
    ways = {
        look.tobytes(): None if poses is None else PlannedPath(len(poses) + 1, np.array([*poses, look]))
        for look, poses in zip(looks, through)
    }
    return two_walls.context(*looks, agent=walker(ways))


def test_the_sum_of_logarithms_by_hand(two_walls, looks) -> None:
    east, west, _ = looks
    context = context_of(two_walls, looks, [[west], [], []])
    # Way to the east: first the west wall, then the east one, of which the west look has told nothing.
    assert information_along(context, np.array([west, east])) == pytest.approx(fisherrf(context)[[1, 0]])
    at_end = fisherrf(context)
    expected = np.exp([
        (0.5 * np.log(at_end[1]) + 0.5 * np.log(at_end[0]) + END_WEIGHT * np.log(at_end[0])) / (1 + END_WEIGHT),
        np.log(at_end[1]),
    ])  # fmt: skip
    assert fisherrf_path(context)[:2] == pytest.approx(expected)
    assert fisherrf_path(context)[2] == 0.0  # shows nothing of the map: no goal


def test_the_path_of_30_actions_weighs_a_fifth_against_30() -> None:
    # Six keyframes in 30 actions with log I_a = 10 and log I_c = 11, against 8 and 11.04: the sums over actions are
    # 6 x 10 / 30 + 30 x 11 = 332.0 and 6 x 8 / 30 + 30 x 11.04 = 332.8.
    first, second = log_of_path(np.full(6, 10.0), 11.0), log_of_path(np.full(6, 8.0), 11.04)
    assert 151 * np.array([first, second]) / 5 == pytest.approx([332.0, 332.8])
    assert first < second


def test_a_path_counts_up_to_its_sixth_keyframe(two_walls, looks) -> None:
    _, west, north = looks
    exact = context_of(two_walls, (west,), [[north] * (HORIZON - 1)])
    longer = context_of(two_walls, (west,), [[north] * (HORIZON - 1) + [west, west]])
    nothing = context_of(two_walls, (west,), [[north] * HORIZON])
    assert fisherrf_path(exact)[0] == fisherrf_path(longer)[0] > fisherrf_path(nothing)[0] > 0.0


def test_a_second_look_at_the_same_knows_the_first(two_walls, looks) -> None:
    """Against the matrices summed up anew for the second look."""
    east, west, _ = looks
    context = two_walls.context(*looks)
    first, second = information_along(context, np.array([west, west]))
    gaussians, poses = two_walls.mapper.map, [frame.world_from_camera for frame in two_walls.mapper.keyframes]
    columns, unit = diagonal_units(context, KINDS)
    known = np.full((gaussians.count, len(columns)), LAMBDA)
    for pose in [*poses, west]:
        (view,) = view_information(gaussians.parameters, gaussians.count, context.camera, pose)
        known[view.indices] += view.numbers[:, columns] / unit
    again = (view.numbers[:, columns] / unit / known[view.indices] * TIMES).sum() / gaussians.count
    assert second == pytest.approx(again, rel=1e-6) and second < 0.7 * first
    assert information_along(context, np.array([west, east]))[1] == pytest.approx(fisherrf(context)[0])


def test_of_two_ways_to_one_view_the_one_that_does_not_look_at_it_before_is_worth_more(two_walls, looks) -> None:
    _, west, _ = looks
    nearer = west.copy()
    nearer[0, 3] -= 0.01
    twice = context_of(two_walls, (west,), [[nearer, nearer]])
    aside = context_of(two_walls, (west,), [[nearer]])
    assert 0.0 < fisherrf_path(twice)[0] < fisherrf_path(aside)[0]


def test_a_view_without_a_way_is_no_goal_and_without_an_agent_the_end_alone_counts(two_walls, looks) -> None:
    assert fisherrf_path(context_of(two_walls, looks, [None, [], None]))[0] == 0.0
    alone = two_walls.context(*looks)
    assert np.array_equal(fisherrf_path(alone), fisherrf(alone))
