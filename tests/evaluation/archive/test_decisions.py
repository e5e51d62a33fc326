"""The stored rows of every decision: what a policy compared, whole, small and without ground truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from activestructure_gym.envs.observation import CANDIDATE_COLUMNS
from activestructure_gym.evaluation.archive.decisions import BEST, DecisionLog, rows_by_decision
from activestructure_gym.evaluation.archive.schema import Mismatch
from activestructure_gym.evaluation.replay.reasons import reason
from activestructure_gym.npz import read_npz, write_npz
from activestructure_gym.policies import Policy, make_policy
from activestructure_gym.policies.base import best_valid, nearest_of_best
from activestructure_gym.policies.scored import recorded_scores

FEATURES = ("pixel",)


def observation(*gains: float, valid: int | None = None) -> dict[str, np.ndarray]:
    count = len(gains)
    views = np.zeros((count, len(CANDIDATE_COLUMNS)), np.float32)
    views[:, 0], views[:, 7] = np.arange(count), 5.0
    return {
        "candidates": views,
        "candidate_features": np.array(gains, np.float32)[:, None],
        "action_mask": (np.arange(count) < (count if valid is None else valid)).astype(np.int8),
    }


def logged(policy: Policy, *observations: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    log = DecisionLog()
    for observed in observations:
        with recorded_scores() as comparisons:
            choice = policy.act(observed)
        log.add(observed, choice, comparisons)
    return log.arrays()


class OnlyScores(Policy):
    """A policy of one's own that gives scores and nothing else."""

    required_features = FEATURES

    def act(self, observation: dict[str, np.ndarray]) -> int:
        return best_valid(self.candidates(observation)["pixel"], observation)


def bound(policy: Policy) -> Policy:
    policy.bind(FEATURES)
    return policy


def test_the_five_best_rows_survive_the_file(tmp_path: Path) -> None:
    policy = bound(make_policy("pixel_only"))
    arrays = logged(policy, observation(0.2, 0.9, 0.5, 0.7, 0.1, 0.6, 0.95, valid=6), observation(0.3, 0.4, valid=1))
    write_npz(tmp_path / "decisions.npz", arrays)
    first, second = rows_by_decision(read_npz(tmp_path / "decisions.npz"), FEATURES)
    assert [row.row for row in first] == [1, 3, 5, 2, 0] and len(first) == BEST
    assert [row.features["pixel"] for row in first] == pytest.approx([0.9, 0.7, 0.6, 0.5, 0.2])
    assert [row.view["x"] for row in first] == [1.0, 3.0, 5.0, 2.0, 0.0]
    assert all(row.score == pytest.approx(row.terms["pixel"] * row.terms["× travel"]) for row in first)
    assert [row.row for row in second] == [0]  # no other row is valid


def test_a_policy_that_gives_only_scores_has_no_terms() -> None:
    (rows,) = rows_by_decision(logged(bound(OnlyScores()), observation(0.2, 0.9)), FEATURES)
    assert [(row.row, row.score, row.terms) for row in rows] == [
        (1, pytest.approx(0.9), {}), (0, pytest.approx(0.2), {}),
    ]  # fmt: skip


def test_a_policy_without_scores_has_its_choice() -> None:
    policy = make_policy("random")
    (rows,) = rows_by_decision(logged(policy, observation(0.2, 0.9)), FEATURES)
    assert [row.score for row in rows] == [None]
    assert rows[0].features["pixel"] == pytest.approx((0.2, 0.9)[rows[0].row])


def test_only_the_comparison_that_led_to_the_choice_counts() -> None:
    class Stubborn(OnlyScores):
        """Compare, and then choose another row."""

        def act(self, observation: dict[str, np.ndarray]) -> int:
            return 1 - super().act(observation)

    (rows,) = rows_by_decision(logged(bound(Stubborn()), observation(0.2, 0.9)), FEATURES)
    assert [(row.row, row.score) for row in rows] == [(0, None)]


def test_of_equal_scores_the_chosen_row_is_first() -> None:
    observed = observation(0.5, 0.5)
    observed["candidates"][0, 7] = 9.0
    with recorded_scores() as comparisons:
        choice = nearest_of_best(np.array([0.5, 0.5]), observed)
    log = DecisionLog()
    log.add(observed, choice, comparisons)
    (rows,) = rows_by_decision(log.arrays(), FEATURES)
    assert [(row.row, row.score) for row in rows] == [(1, 0.5), (0, 0.5)]


def test_nothing_is_recorded_outside_the_block() -> None:
    with recorded_scores() as comparisons:
        pass
    best_valid(np.array([1.0, 2.0]), observation(0.1, 0.2))
    assert comparisons == []


def test_terms_are_those_of_the_comparison_even_if_the_policy_changes_them_later() -> None:
    observed, gain = observation(0.2, 0.9), np.array([0.2, 0.9])
    log = DecisionLog()
    with recorded_scores() as comparisons:
        choice = best_valid(gain, observed, {"gain": gain})
        gain[choice] = 0.0
    log.add(observed, choice, comparisons)
    (rows,) = rows_by_decision(log.arrays(), FEATURES)
    assert [(row.score, row.terms["gain"]) for row in rows] == [(0.9, 0.9), (0.2, 0.2)]


def test_the_terms_of_two_forms_of_decisions_are_told_apart() -> None:
    class Switching(OnlyScores):
        """Score by the gain once, then by a factor alone, then without terms."""

        number = 0

        def act(self, observation: dict[str, np.ndarray]) -> int:
            gain = self.candidates(observation)["pixel"]
            forms = ({"pixel": gain}, {"× factor": gain}, None)
            self.number += 1
            return best_valid(gain, observation, forms[self.number - 1])

    three = rows_by_decision(logged(bound(Switching()), *[observation(0.25, 0.75)] * 3), FEATURES)
    assert [rows[0].terms for rows in three] == [{"pixel": 0.75}, {"× factor": 0.75}, {}]
    assert ["Chosen for its pixel of " in reason("mine", rows) for rows in three] == [True, False, False]
    assert ["Chosen for its factor of " in reason("mine", rows) for rows in three] == [False, True, False]


def test_a_damaged_file_is_refused() -> None:
    good = logged(bound(make_policy("pixel_only")), observation(0.2, 0.9), observation(0.3, 0.4))
    rows_by_decision(good, FEATURES)
    damages: dict[str, tuple[str, np.ndarray]] = {
        "starts does not fit": ("starts", good["starts"][:-1]),
        "must have 1 to 5 rows": ("starts", np.array([0, 0, 4])),
        "scores: expected 3": ("rows", good["rows"][:-1]),
        "rows holds numbers outside": ("rows", good["rows"] - 5),
        "not finite": ("scores", np.full(4, np.nan)),
        "it holds 2 features": ("features", np.zeros((4, 2), np.float32)),
    }
    for message, (name, array) in damages.items():
        with pytest.raises(Mismatch, match=message):
            rows_by_decision({**good, name: array}, FEATURES)
    with pytest.raises(Mismatch, match="lacks the array scored"):
        rows_by_decision({name: array for name, array in good.items() if name != "scored"}, FEATURES)


def test_an_episode_without_decisions_has_an_empty_file() -> None:
    assert rows_by_decision(DecisionLog().arrays(), FEATURES) == []


def test_infinite_numbers_of_a_policy_are_stored_as_the_limit() -> None:
    (rows,) = rows_by_decision(logged(bound(OnlyScores()), observation(0.2, np.inf)), FEATURES)
    assert rows[0].row == 1 and rows[0].score == 1e15
