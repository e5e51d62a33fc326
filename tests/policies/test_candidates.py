"""The view of the candidates by name, on a table whose every entry is another number."""

from __future__ import annotations

import doctest
import re
from pathlib import Path

import numpy as np
import pytest

from activestructure_gym.envs.observation import CANDIDATE_COLUMNS, candidate_columns
from activestructure_gym.errors import InputError
from activestructure_gym.features import column_names
from activestructure_gym.policies import candidates, make_policy
from activestructure_gym.policies.candidates import Candidates
from activestructure_gym.policies.hole_area import HoleArea
from activestructure_gym.policies.naruto import Naruto

ROOT = Path(__file__).resolve().parents[2]
NAMES = column_names(("gs_planner_loss", "naruto_look", "pixel", "activeinr", "gs_planner_volume"))


@pytest.fixture
def observation() -> dict[str, np.ndarray]:
    table = np.arange(45, dtype=np.float32).reshape(5, 9)
    table[:, CANDIDATE_COLUMNS.index("revisit")] = [0, 1, 0, 1, 0]
    features = 100.0 + np.arange(5 * len(NAMES), dtype=np.float32).reshape(5, -1)
    return {"candidates": table, "candidate_features": features, "action_mask": np.array([1, 1, 1, 0, 0], np.int8)}


def test_every_column_by_its_name(observation: dict[str, np.ndarray]) -> None:
    seen, table = Candidates(observation), observation["candidates"]
    assert len(seen) == 5
    np.testing.assert_array_equal(np.hstack([seen.xyz, seen.view_direction]), table[:, :6])
    np.testing.assert_array_equal(np.column_stack([seen.path_length, seen.frames]), table[:, 6:8])
    assert seen.revisit.tolist() == [False, True, False, True, False]
    assert seen.valid.tolist() == [True, True, True, False, False]
    assert candidate_columns(*CANDIDATE_COLUMNS) == list(range(9))


def test_rows_that_end_or_switch_are_no_views(observation: dict[str, np.ndarray]) -> None:
    assert Candidates(observation).views.tolist() == [True, True, True, False, False]
    rows = (*CANDIDATE_COLUMNS, "from_pool", "from_finish?rows=1", "from_finisher", "ask_1")
    kinds = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1], [1, 0, 0, 0], [0, 0, 1, 0]], np.float32)
    observation["candidates"] = np.hstack([observation["candidates"], kinds])
    observation["action_mask"][4] = 1
    seen = Candidates(observation, rows=rows)
    assert seen.views.tolist() == [True, False, False, False, True]
    assert seen.valid.tolist() == [True, True, True, False, True]
    policy = make_policy("random")
    policy._rows = rows
    assert policy.only_views(observation)["action_mask"].tolist() == [1, 0, 0, 0, 1]
    observation["action_mask"][[0, 4]] = 0  # nothing else is left
    assert policy.only_views(observation) is observation


def test_features_and_single_columns(observation: dict[str, np.ndarray]) -> None:
    seen, features = Candidates(observation, NAMES), observation["candidate_features"]
    for place, name in enumerate(NAMES):
        np.testing.assert_array_equal(seen[name], features[:, place])
    np.testing.assert_array_equal(seen.feature("naruto_look"), features[:, 1:31])
    np.testing.assert_array_equal(seen.feature("pixel")[:, 0], seen["pixel"])
    # In the feature's order, wherever its columns stand; one is called like the feature.
    np.testing.assert_array_equal(seen.feature("gs_planner"), features[:, [len(NAMES) - 1, 0]])
    np.testing.assert_array_equal(seen.feature("activeinr")[:, 0], seen["activeinr"])


def test_what_is_not_there_is_said_in_one_sentence(observation: dict[str, np.ndarray]) -> None:
    for read in (lambda seen: seen["hole_area"], lambda seen: seen.feature("hole_area")):
        with pytest.raises(
            InputError, match=r"^this policy is not bound, so the column of the feature 'hole_area' is unknown"
        ):
            read(Candidates(observation))
        with pytest.raises(
            InputError, match=r"^Mine reads the feature 'hole_area', and the env offers gs_planner_loss, "
        ):
            read(Candidates(observation, NAMES, "Mine"))
        with pytest.raises(
            InputError, match=r"^Mine is bound to an env with the features pixel, but this observation's"
        ):
            read(Candidates(observation, ("pixel",), "Mine"))
    with pytest.raises(InputError, match="unknown feature 'naruto_looks'; did you mean 'naruto_look'"):
        Candidates(observation, NAMES).feature("naruto_looks")


def test_a_policy_is_bound_by_features_and_says_which_are_missing() -> None:
    policy = Naruto()
    with pytest.raises(InputError, match="^Naruto needs the features naruto_look, and the env offers naruto, naruto_"):
        policy.bind(("naruto", "naruto_look_0_x"))
    policy.bind(column_names(("pixel", *reversed(policy.required_features))))
    with pytest.raises(InputError, match="^HoleArea needs the features hole_area, and the env offers none"):
        HoleArea().bind(())


def test_the_example_runs() -> None:
    failed, tried = doctest.testmod(candidates)
    assert tried and not failed


def test_nobody_indexes_columns_by_hand() -> None:
    """Of the table and the features; `candidates.py` and the network's inputs name them."""
    by_hand = re.compile(r'CANDIDATE_COLUMNS\.index|"candidates"\]\[|"candidate_features"\]\[:, *\w')
    rooms = [ROOT / "policies", ROOT / "evaluation" / "training"]
    found = [file.name for room in rooms for file in room.rglob("*.py") if by_hand.search(file.read_text())]
    assert found == []
