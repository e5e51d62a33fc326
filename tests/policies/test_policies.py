"""Contracts over every registered policy, and the two built-in ones by hand."""

from __future__ import annotations

import pickle
import re
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor

from activestructure_gym.envs.observation import CANDIDATE_COLUMNS, Table
from activestructure_gym.errors import InputError
from activestructure_gym.planes import PLANE_FEATURES
from activestructure_gym.policies import POLICIES, Policy, travel_discount
from activestructure_gym.policies.base import best_valid, nearest_new
from activestructure_gym.policies.hole_area import HoleArea
from activestructure_gym.policies.pixel_only import PixelOnly
from activestructure_gym.policies.random import Random
from tests.policies.binding import bound, columns

ALL = sorted(POLICIES)


def observation(rng: np.random.Generator, rows: int = 12, valid: int = 8, features: int = 1) -> dict[str, np.ndarray]:
    candidates = rng.uniform(0, 5, (rows, len(CANDIDATE_COLUMNS))).astype(np.float32)
    mask = np.zeros(rows, np.int8)
    mask[:valid] = 1
    return {
        "candidates": candidates,
        "candidate_features": rng.uniform(0, 1, (rows, features)).astype(np.float32),
        "action_mask": mask,
        "candidate_planes": rng.integers(0, 2, (rows, 4)).astype(np.int8),
        "plane_mask": np.array([1, 1, 1, 0], np.int8),
        "plane_features": rng.uniform(0, 1, (4, len(PLANE_FEATURES))).astype(np.float32),
        "plane_edges": np.zeros((4, 4), np.float32),
        "fidelity": np.array([20.0, 25.0], np.float32),
        "pose": np.array([1.0, 2.0, 1.5, 1.0, 0.0, 0.0, 0.0], np.float32),
        "budget": np.array([0.7], np.float32),
    }


@pytest.mark.parametrize("name", ALL)
def test_never_a_masked_row_deterministic_and_picklable(name: str, rng: np.random.Generator) -> None:
    first, second = bound(POLICIES.get(name)()), bound(POLICIES.get(name)())
    first.reset(3)
    second.reset(3)
    for valid in (1, 2, 8, 12):
        observed = observation(rng, valid=valid, features=max(1, len(columns(first))))
        before = {key: value.copy() for key, value in observed.items()}
        choice = first.act(observed)
        assert isinstance(choice, int)
        assert observed["action_mask"][choice] == 1
        for key, value in before.items():
            np.testing.assert_array_equal(observed[key], value)
        second = pickle.loads(pickle.dumps(second))
        assert second.act(observed) == choice
        assert isinstance(first.trace(), dict)


@pytest.mark.parametrize("name", ALL)
def test_no_valid_row_is_an_error(name: str, rng: np.random.Generator) -> None:
    policy = bound(POLICIES.get(name)())
    policy.reset(0)
    with pytest.raises(ValueError, match="no candidate is valid"):
        policy.act(observation(rng, valid=0, features=max(1, len(columns(policy)))))


def test_random_reaches_every_valid_row_and_no_other(rng: np.random.Generator) -> None:
    policy = Random()
    policy.reset(0)
    observed = observation(rng, valid=5)
    counts = np.bincount([policy.act(observed) for _ in range(2000)], minlength=12)
    assert (counts[5:] == 0).all()
    assert counts[:5].min() > 300  # 400 expected, standard deviation 18


@pytest.mark.parametrize(("greedy", "gain"), [(PixelOnly, "pixel"), (HoleArea, "hole_area")])
def test_greedy_by_hand(greedy: type[Policy], gain: str, rng: np.random.Generator) -> None:
    assert greedy.required_features == (gain,)
    observed = observation(rng, rows=3, valid=3)
    observed["candidate_features"][:, 0] = [0.5, 0.6, 0.9]
    observed["candidates"][:, CANDIDATE_COLUMNS.index("frames")] = [5.0, 10.0, 45.0]
    # 0.5 / 2 = 0.25, 0.6 / 3 = 0.2, 0.9 / 10 = 0.09
    policy = bound(greedy())
    policy.reset(0)
    assert policy.act(observed) == 0
    assert policy.trace() == {gain: pytest.approx(0.5), "travel": pytest.approx(0.5)}
    observed["candidate_features"][1, 0] = 0.9  # 0.3
    assert policy.act(observed) == 1
    observed["candidate_features"][:, 0] = 0.0  # everything covered: the nearest
    assert policy.act(observed) == 0


class Dull(gym.Env):
    """An env that does nothing but say what stands in its observation."""

    def __init__(self, features: tuple[str, ...] = ("hole_area", "other", "pixel"), said: bool = True) -> None:
        low, high = np.zeros((12, len(features)), np.float32), np.ones((12, len(features)), np.float32)
        table = Table(features, low, high) if said else gym.spaces.Box(low, high)
        self.observation_space = gym.spaces.Dict({"candidate_features": table})
        self.action_space = gym.spaces.Discrete(12)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[dict[str, np.ndarray], dict]:
        return self.observation_space.sample(), {}


@pytest.mark.parametrize(
    "told_by",
    [
        lambda: ("hole_area", "other", "pixel"),
        lambda: ["hole_area", "other", "pixel"],
        lambda: Dull(),
        lambda: gym.wrappers.FilterObservation(gym.wrappers.TimeLimit(Dull(), 5), ["candidate_features"]),
        lambda: Dull().observation_space,
        lambda: Dull().observation_space["candidate_features"],
        lambda: gym.vector.SyncVectorEnv([Dull, Dull]),
        lambda: VecMonitor(DummyVecEnv([Dull, Dull])),
    ],
)
def test_features_are_found_by_name_whatever_their_order_and_whoever_tells_it(
    told_by: Callable[[], Any], rng: np.random.Generator
) -> None:
    observed = observation(rng, features=3)
    policy = PixelOnly()
    policy.bind(told_by())
    for bound_one in (policy, pickle.loads(pickle.dumps(policy))):
        np.testing.assert_array_equal(bound_one.candidates(observed)["pixel"], observed["candidate_features"][:, 2])


@pytest.mark.parametrize(
    ("source", "message"),
    [
        (
            ("hole_area",),
            "PixelOnly needs the features pixel, and the env offers hole_area: make the env with",
        ),
        ((), "PixelOnly needs the features pixel, and the env offers none"),
        ("pixel", "the names of the feature columns come from an env, from its observation space or from a list"),
        (None, "the names of the feature columns come from an env"),
        (("pixel", 3), "the names of the feature columns come from an env"),
        (Dull(said=False), "this observation space has no names for the columns"),
        (
            gym.spaces.Dict({"rgb": gym.spaces.Discrete(2)}),
            "observations have rgb, and no candidate_features: add this key",
        ),
    ],
)
def test_what_a_policy_cannot_be_bound_to(source: Any, message: str) -> None:
    with pytest.raises(InputError) as caught:
        PixelOnly().bind(source)
    assert message in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ALL)
def test_nobody_reads_a_feature_by_its_place(name: str, rng: np.random.Generator) -> None:
    """Unbound, a policy that reads features refuses; so does one that is bound to an env with more or fewer of them."""
    policy = POLICIES.get(name)()
    policy.reset(0)
    observed = observation(rng, features=max(1, len(columns(policy))))
    if not policy.required_features:
        assert observed["action_mask"][policy.act(observed)] == 1
        return
    with pytest.raises(InputError, match=r"^\w+ is not bound, so .* call policy.bind\(env\) before act"):
        policy.act(observed)
    policy.bind((*columns(policy), "more"))
    with pytest.raises(InputError, match=r"^\w+ is bound to an env with the features .*: call policy.bind\(env\) with"):
        policy.act(observed)


def test_a_feature_that_was_not_asked_for_and_features_that_are_no_names(rng: np.random.Generator) -> None:
    policy = bound(PixelOnly())
    with pytest.raises(InputError, match="reads the feature 'structure', and the env offers pixel"):
        policy.candidates(observation(rng))["structure"]
    batch = np.stack([observation(rng)["candidate_features"]] * 2)
    with pytest.raises(InputError, match=r"candidate_features has the shape \(2, 12, 1\)"):
        policy.candidates({"candidate_features": batch})["pixel"]
    for wrong in ("pixel", (1,), None):
        policy.required_features = wrong  # type: ignore[misc]
        with pytest.raises(InputError, match="required_features of PixelOnly must be a tuple of names, got"):
            policy.bind(("pixel",))


def test_a_policy_that_forgets_its_base_s_constructor_is_bound_all_the_same(rng: np.random.Generator) -> None:
    class Forgetful(PixelOnly):
        def __init__(self) -> None:
            self.travel, self._trace = "shared", {}

    observed = observation(rng)
    assert bound(Forgetful()).act(observed) == bound(PixelOnly()).act(observed)


def test_travel_discount_best_valid_and_nearest_new(rng: np.random.Generator) -> None:
    observed = observation(rng, rows=3, valid=2)
    observed["candidates"][:, CANDIDATE_COLUMNS.index("frames")] = [0.0, 5.0, 45.0]
    np.testing.assert_allclose(travel_discount(observed), [1.0, 0.5, 0.1], rtol=1e-6)
    assert best_valid(np.array([1.0, 1.0, 5.0]), observed) == 0
    observed["candidates"][:, CANDIDATE_COLUMNS.index("revisit")] = [1.0, 1.0, 0.0]
    assert nearest_new(observed) == 0  # both revisits: row 2 is masked
    observed["candidates"][1, CANDIDATE_COLUMNS.index("revisit")] = 0.0
    assert nearest_new(observed) == 1


def test_a_score_that_is_no_number_is_not_the_best(rng: np.random.Generator) -> None:
    observed = observation(rng, rows=3, valid=2)
    assert best_valid(np.array([1.0, 2.0, np.nan]), observed) == 1  # nobody offers that row
    with pytest.raises(ValueError, match="every valid row must be a number, got nan in row 1"):
        best_valid(np.array([1.0, np.nan, 0.0]), observed)


@pytest.mark.parametrize("shape", [(), (2,), (3, 1), (3, 3)])
def test_scores_without_one_number_per_row_are_refused(shape: tuple[int, ...], rng: np.random.Generator) -> None:
    message = re.escape(f"scores must have one number per row, (3,), got {shape}")
    with pytest.raises(InputError, match=message):
        best_valid(np.zeros(shape), observation(rng, rows=3))


def test_without_a_score_the_first_valid_row_is_the_best(rng: np.random.Generator) -> None:
    observed = observation(rng, rows=3)
    observed["action_mask"] = np.array([0, 1, 1], np.int8)
    assert best_valid(np.full(3, -np.inf), observed) == 1


@pytest.mark.parametrize("term", [0.5, [0.5, 0.5], np.ones((3, 1))])
def test_a_term_has_one_number_per_row(rng: np.random.Generator, term: object) -> None:
    """A run with other terms would fail after the decision, or have files that cannot be read."""
    with pytest.raises(InputError, match=r"term 'mine' must have one number per row, \(3,\), got \("):
        best_valid(np.ones(3), observation(rng, rows=3, valid=2), {"mine": term})
    with pytest.raises(InputError, match=r"terms must be a dict of arrays by name, got \[1, 2\]"):
        best_valid(np.ones(3), observation(rng, rows=3, valid=2), [1, 2])  # type: ignore[arg-type]


def test_a_third_party_policy_registers_in_a_few_lines(rng: np.random.Generator) -> None:
    @POLICIES.register("nearest_for_this_test")
    class Nearest(Policy):
        def act(self, observation: dict[str, np.ndarray]) -> int:
            return best_valid(travel_discount(observation), observation)

    try:
        policy = POLICIES.get("nearest_for_this_test")()
        observed = observation(rng)
        lengths = observed["candidates"][:8, CANDIDATE_COLUMNS.index("frames")]
        assert policy.act(observed) == lengths.argmin()
    finally:
        del POLICIES._entries["nearest_for_this_test"]
