"""`unseen`: space first, then sides, by the way."""

from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.policies import make_policy
from activestructure_gym.policies.base import patience
from activestructure_gym.policies.unseen.policy import SIDE_DEPTH
from tests.policies.activestructure.test_policy import observation
from tests.policies.binding import bound


def test_a_square_metre_seen_from_behind_counts_as_so_much_unknown_space() -> None:
    policy = bound(make_policy("unseen"))
    policy.reset(0)
    assert policy.act(observation([[0.3, 0.0], [0.0, 1.0], [0.1, 0.2]])) == 1
    assert policy.trace()["sides"] == pytest.approx(SIDE_DEPTH)
    assert policy.act(observation([[0.4, 0.0], [0.0, 1.0], [0.1, 0.2]])) == 0
    assert policy.act(observation([[0.3, 0.0], [0.0, 1.0], [0.1, 0.8]])) == 2  # .1 + .28


def test_a_near_view_goes_first() -> None:
    policy = bound(make_policy("unseen"))
    policy.reset(0)
    choices = [policy.act(observation([[1.0, 0.0], [0.6, 0.0]], frames=frames)) for frames in ([5.0, 5.0], [30.0, 5.0])]
    assert choices == [0, 1]


def test_with_the_same_gain_the_rungs_choose_as_it_does_where_no_plane_is() -> None:
    ours, rung = bound(make_policy("unseen")), bound(make_policy("activestructure-b?discovery=unseen"))
    features = np.random.default_rng(0).uniform(0, 1, (30, 12, 2))
    for table in features:
        told = observation(table.tolist())
        assert ours.act(told) == rung.act(told)


def test_the_full_model_looks_at_far_sides_once_the_scaffold_stands() -> None:
    policy = bound(make_policy("activestructure?discovery=unseen"))
    policy.reset(0)
    rows = [[0.05, 0.0, 0.0, 0.05], [0.0, 0.8, 0.0, 0.0]]  # space of the way, sides, deficiency, space of the view
    choices, phases, needed = [], [], patience(len(rows) + 1)
    for _ in range(2 * needed):
        choices.append(policy.act(observation(rows)))
        phases.append(policy.trace()["phase"])
    # .05 m^3 is too little for the pool of phase I, and the sides, .28 m^3, count in phase II alone.
    assert choices == [0] * (needed - 1) + [1] * (needed + 1)
    assert phases == ["I scaffold"] * (needed - 1) + ["II objects"] * (needed + 1)
