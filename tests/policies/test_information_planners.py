"""The planners of information gains: no travel of their own, and HGS-Planner's stages."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from activestructure_gym.envs.observation import CANDIDATE_COLUMNS
from activestructure_gym.features import FEATURES
from activestructure_gym.policies import POLICIES
from activestructure_gym.policies.hgs_planner import HGSPlanner
from activestructure_gym.policies.hgs_planner.policy import MIN_COVERAGE, shortest_tour
from tests.policies.binding import bound

CRITERIA = ("logdet", "cov_trace", "info_trace", "min_eig", "logdet_block", "cov_trace_block")
NAMES = ["fisherrf", "gauss_mi", "next_best_sense", *(f"popgs_{name}" for name in CRITERIA)]


def observation(gains: list, frames: list, **features: Any) -> dict[str, np.ndarray]:
    candidates = np.zeros((len(gains), len(CANDIDATE_COLUMNS)), np.float32)
    for name, values in {"frames": frames, **features}.items():
        candidates[:, CANDIDATE_COLUMNS.index(name)] = values
    return {
        "candidates": candidates,
        "candidate_features": np.array(gains, np.float32).reshape(len(gains), -1),
        "action_mask": np.ones(len(gains), np.int8),
        "pose": np.array([0, 0, 0, 0.5, 0.5, 0.5, 0.5], np.float32),
    }


@pytest.mark.parametrize("name", [name + form for name in NAMES for form in ("", "_cov")])
def test_the_way_counts_only_where_it_is_asked_for(name: str) -> None:
    policy = bound(POLICIES.get(name)())
    assert policy.required_features == (name,) and name in FEATURES
    observed = observation([0.5, 0.6, 0.1], [5, 50, 1])
    assert policy.act(observed) == 1
    assert bound(POLICIES.get(name)(travel="shared")).act(observed) == 0


@pytest.mark.parametrize("name", ["popgs_info_trace", "popgs_info_trace_cov"])
def test_the_information_of_a_view_that_is_taken_does_not_fall_so_it_is_not_taken_again(name: str) -> None:
    policy = bound(POLICIES.get(name)())
    assert policy.act(observation([0.5, 0.6, 0.1], [5, 1, 1], revisit=[0, 1, 0])) == 0
    assert policy.act(observation([0.5, 0.6], [5, 1], revisit=[1, 1])) == 1  # nothing else is offered


def test_stages_of_hgs_planner() -> None:
    policy = bound(HGSPlanner())
    # G, G_cov: a near view, the best of all far away, a near one without anything unseen.
    gains = [[0.5, 0.1], [0.9, 0.3], [0.7, 0.0]]
    ways = {"path_length": [5.0, 9.0, 1.0], "x": [1, 9, 1], "y": [1, 1, 1]}  # near is what is in the window
    assert policy.act(observation(gains, [20, 90, 10], **ways)) == 0
    assert policy.trace()["stage"] == "local"
    gains[0][1] = MIN_COVERAGE  # not above
    assert policy.act(observation(gains, [20, 90, 10], **ways)) == 1
    assert policy.trace()["stage"] == "global"
    gains[1][1] = 0.0
    gains[1][0] = 0.6
    assert policy.act(observation(gains, [20, 90, 10], **ways)) == 2
    assert policy.trace()["stage"] == "refine"
    assert bound(HGSPlanner(travel="shared")).act(observation(gains, [20, 90, 10], **ways)) == 2


def test_the_local_tour_goes_to_the_good_view_on_the_way_first() -> None:
    # 3 m east with G = 1, 0.5 m west with 0.9: 0.5 + 3.5 m are less than 3 + 3.5 m.
    gains, place = [[1.0, 0.5], [0.9, 0.5]], {"path_length": [3.0, 0.5], "x": [4.0, 0.5], "y": [1.0, 1.0]}
    assert bound(HGSPlanner()).act(observation(gains, [30, 5], **place)) == 1
    # Within 1.5 m only the best view counts, however near the others are.
    near = {"path_length": [2.0, 1.0], "x": [3.0, 2.0], "y": [1.0, 1.0]}
    assert bound(HGSPlanner()).act(observation(gains, [20, 10], **near)) == 0


def test_the_tour_begins_where_the_whole_way_is_shortest() -> None:
    # One part 5 m to the left; two to the right at 6 and 7 m: first the left one, then the others.
    assert shortest_tour(np.array([6.0, 5.0, 7.0]), np.array([[6.0, 0], [-5, 0], [7, 0]]))[0] == 1
    # A wall makes the way to the left one long: it comes last.
    assert shortest_tour(np.array([6.0, 30.0, 7.0]), np.array([[6.0, 0], [-5, 0], [7, 0]]))[0] == 0
    many = np.arange(20.0)[::-1]
    assert shortest_tour(many, np.stack([many, many], axis=1))[0] == 19


def test_the_next_part_is_entered_at_its_best_view() -> None:
    gains = [[0.2, 0.1], [0.4, 0.1], [0.9, 0.0], [0.8, 0.1]]
    # Two parts: x in 6..12 with three views, x above 18 with one. The best view there has nothing unseen.
    ways = {"path_length": [6, 8, 7, 20], "x": [7, 8, 8, 20]}
    assert bound(HGSPlanner()).act(observation(gains, [1, 1, 1, 1], **ways)) == 1
