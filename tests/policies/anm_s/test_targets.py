"""The target and the node on the way to it, by hand."""

from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.policies.anm_s.targets import DEFERRED_M, next_target

HERE = np.zeros(2)


def choose(rows: list[tuple[float, float, float, float]]) -> int:
    """Rows of (score, path length, x, y)."""
    scores, lengths, *places = np.transpose(rows)
    return next_target(scores, lengths, np.column_stack(places), HERE)


def test_the_highest_score_then_the_shortest_path() -> None:
    assert choose([(5, 1.0, 1, 0), (6, 3.0, 3, 0), (6, 2.0, 0, 2)]) == 2
    assert choose([(5, 1.0, 1, 0), (6, DEFERRED_M, 13, 0)]) == 1


def test_on_the_way_to_a_far_target_the_score_counts_before_the_distance() -> None:
    """C has 5 points 4 m from the agent and 13 m from the target; D has none, 12 m from the agent and 4 m from it."""
    target, c, d = (6, 16.0, 16, 0), (5, 4.0, 3.71875, 4.27), (0, 12.0, 12, 0)
    assert np.linalg.norm(np.subtract(c[2:], target[2:])) == pytest.approx(13.0, abs=0.01)
    assert choose([target, c, d]) == 1
    assert choose([target, (0, 4.0, 3.71875, 4.27), d]) == 2  # of equal scores the nearest to the target


def test_a_node_on_the_way_is_nearer_to_the_target_and_not_far_itself() -> None:
    target = (6, 16.0, 16, 0)
    assert choose([target, (5, 4.0, -4, 0)]) == 0
    assert choose([target, (5, DEFERRED_M, 12, 0)]) == 0
