"""Fiedler centrality on graphs that can be solved by hand, and what the rule is blind to."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import spearmanr

from activestructure_gym.envs.observation import CANDIDATE_COLUMNS
from activestructure_gym.policies.activepolicy import ActivePolicy
from activestructure_gym.policies.activepolicy.policy import BEST, EPSILON, fiedler_centrality, relation
from tests.policies.binding import bound

X, Y, Z = np.eye(3)


def observation(views: list[tuple], *, planes: list | None = None, frames: list | None = None) -> dict[str, np.ndarray]:
    """Rows of (position, direction, gain), and one masked row."""
    count = len(views)
    candidates = np.zeros((count + 1, len(CANDIDATE_COLUMNS)), np.float32)
    features = np.zeros((count + 1, 1), np.float32)
    for k, (position, direction, gain) in enumerate(views):
        candidates[k, :3], candidates[k, 3:6], features[k] = position, direction, gain
    candidates[:count, CANDIDATE_COLUMNS.index("frames")] = frames or [5.0] * count
    seen = np.zeros((count + 1, 4), np.int8)
    if planes is not None:
        seen[:count] = planes
    return {
        "candidates": candidates, "candidate_features": features, "candidate_planes": seen,
        "action_mask": (np.arange(count + 1) < count).astype(np.int8), "plane_mask": np.array([1, 1, 1, 0], np.int8),
    }  # fmt: skip


def test_a_path_by_hand() -> None:
    # Node 0 hangs between 1 and 2 with equal weights: eigenvalues 0, 1, 2; of 1 it is (0, 1, -1) / sqrt 2.
    np.testing.assert_allclose(
        fiedler_centrality(np.ones(2), np.zeros((2, 2))), 1.0 / (np.sqrt(0.5) + EPSILON), rtol=1e-9
    )


def test_of_a_star_the_largest_gain_is_the_most_central() -> None:
    # All but two eigenvalues are 1; the part of node i in their space has the squared length 1 - w_i / sum w.
    gain = np.array([3.0, 1.0, 2.0, 2.0])
    expected = np.sqrt((1.0 - gain / 8.0) / 3.0)
    np.testing.assert_allclose(fiedler_centrality(gain, np.zeros((4, 4))), 1.0 / (expected + EPSILON), rtol=1e-6)


def test_two_groups_and_one_between_them_by_symmetry() -> None:
    # 1 and 2 go with each other, so do 3 and 4; 5 goes with all: by symmetry the Fiedler vector is 0 there.
    between = np.zeros((5, 5))
    between[0, 1] = between[2, 3] = 1.0
    between[:4, 4] = 0.3
    scores = fiedler_centrality(np.full(5, 0.4), between + between.T)
    assert scores.argmax() == 4
    assert scores[4] == pytest.approx(1.0 / EPSILON, rel=1e-6)
    np.testing.assert_allclose(scores[:4], scores[0])


def test_relation_by_hand() -> None:
    views = [(0 * X, X, 1.0), (2 * X, X, 1.0), (2 * X, (X + Y) / np.sqrt(2), 1.0), (0 * X, -X, 1.0)]
    seen = [[1, 1, 0, 1], [1, 0, 1, 1], [0, 0, 0, 1], [0, 0, 0, 0]]  # the last plane is masked
    found = relation(observation(views, planes=seen), np.arange(4))
    near = np.exp(-2.0 / 1.0)  # half of the pairs are 2 m apart, so the mean is 1
    np.testing.assert_allclose(found[0], [1.0, near / 3, 0.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(found[2, 3], 0.0, atol=1e-6)  # no planes: they look away from each other
    np.testing.assert_allclose(found, found.T)
    without = relation(observation(views), np.arange(4))
    np.testing.assert_allclose(without[0, 2], near * np.sqrt(0.5), rtol=1e-6)


def test_only_the_16_best_views_are_nodes(rng: np.random.Generator) -> None:
    features = rng.permutation(np.arange(1, 41)) / 40.0
    views = [(rng.uniform(0, 5, 3), X, g) for g in features]
    policy = bound(ActivePolicy())
    choice = policy.act(observation(views))
    assert features[choice] > (40 - BEST) / 40.0
    assert policy.trace()["nodes"] == BEST
    assert policy.trace()["rank_by_gain"] == round(40 * (1 - features[choice]))


def test_views_without_gain_are_no_nodes_and_without_any_it_is_the_nearest() -> None:
    policy = bound(ActivePolicy())
    assert policy.act(observation([(X, X, 0.0), (Y, X, 0.2), (Z, X, 0.0)])) == 1
    assert policy.act(observation([(X, X, 0.0), (Y, X, 0.0)], frames=[9.0, 3.0])) == 1
    assert policy.trace() == {"nodes": 0}
    observed = observation([(X, X, 0.0), (Y, X, 0.0)], frames=[9.0, 1.0])
    observed["candidates"][1, CANDIDATE_COLUMNS.index("revisit")] = 1.0
    assert policy.act(observed) == 0


def test_the_shared_travel_term_multiplies_the_centrality() -> None:
    views = [(0 * X, X, 0.5), (9 * X, X, 0.5)]
    seen = [[1, 0, 0, 0], [0, 1, 0, 0]]
    frames = [50.0, 1.0]
    # equally central: the nearer one
    assert bound(ActivePolicy()).act(observation(views, planes=seen, frames=frames)) == 1
    views[0] = (0 * X, X, 0.6)  # a little more central
    assert bound(ActivePolicy()).act(observation(views, planes=seen, frames=frames)) == 0
    assert bound(ActivePolicy(travel="shared")).act(observation(views, planes=seen, frames=frames)) == 1


def test_of_many_that_gain_the_same_the_nearest_are_nodes_and_of_equally_central_ones_the_nearest_is_taken() -> None:
    frames = np.random.default_rng(4).permutation(np.arange(1.0, 41.0))
    views = [(0 * X, X, 1.0)] * 40
    policy = bound(ActivePolicy())
    assert frames[policy.act(observation(views, frames=frames.tolist()))] == 1.0
    views = [(9.0 * k * X, X, 1.0) for k in range(40)]
    assert frames[policy.act(observation(views, frames=frames.tolist()))] <= BEST


def test_the_rule_is_nearly_blind_to_the_gain() -> None:
    """The pathology that the pre-filter is there for: it is what overlaps that decides."""
    rng = np.random.default_rng(3)
    correlation = []
    for _ in range(30):
        places, gain = rng.uniform(0, 6, (64, 3)), rng.gamma(2.0, size=64)
        distance = np.linalg.norm(places[:, None] - places, axis=2)
        between = np.exp(-distance / distance.mean()) * rng.uniform(0, 1, (64, 64))
        correlation.append(spearmanr(fiedler_centrality(gain, (between + between.T) / 2), gain)[0])
    assert abs(np.mean(correlation)) < 0.2
