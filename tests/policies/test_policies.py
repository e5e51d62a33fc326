"""Contracts over every registered policy, and the two built-in ones by hand."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from activestructure_gym.envs.observation import CANDIDATE_FEATURES
from activestructure_gym.planes import PLANE_FEATURES
from activestructure_gym.policies import POLICIES, HoleArea, PixelOnly, Policy, Random, travel_discount
from activestructure_gym.policies.base import best_valid, nearest_new

ALL = sorted(POLICIES)


def observation(rng: np.random.Generator, rows: int = 12, valid: int = 8, gains: int = 1) -> dict[str, np.ndarray]:
    candidates = rng.uniform(0, 5, (rows, len(CANDIDATE_FEATURES))).astype(np.float32)
    mask = np.zeros(rows, np.int8)
    mask[:valid] = 1
    return {
        "candidates": candidates,
        "candidate_gains": rng.uniform(0, 1, (rows, gains)).astype(np.float32),
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
    first, second = POLICIES.get(name)(), POLICIES.get(name)()
    first.reset(3)
    second.reset(3)
    for valid in (1, 2, 8, 12):
        observed = observation(rng, valid=valid, gains=max(1, len(first.required_gains)))
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
    policy = POLICIES.get(name)()
    policy.reset(0)
    with pytest.raises(ValueError, match="no candidate is valid"):
        policy.act(observation(rng, valid=0, gains=max(1, len(policy.required_gains))))


def test_random_reaches_every_valid_row_and_no_other(rng: np.random.Generator) -> None:
    policy = Random()
    policy.reset(0)
    observed = observation(rng, valid=5)
    counts = np.bincount([policy.act(observed) for _ in range(2000)], minlength=12)
    assert (counts[5:] == 0).all()
    assert counts[:5].min() > 300  # 400 expected, standard deviation 18


@pytest.mark.parametrize(("greedy", "gain"), [(PixelOnly, "pixel"), (HoleArea, "hole_area")])
def test_greedy_by_hand(greedy: type[Policy], gain: str, rng: np.random.Generator) -> None:
    assert greedy.required_gains == (gain,)
    observed = observation(rng, rows=3, valid=3)
    observed["candidate_gains"][:, 0] = [0.5, 0.6, 0.9]
    observed["candidates"][:, CANDIDATE_FEATURES.index("frames")] = [5.0, 10.0, 45.0]
    # 0.5 / 2 = 0.25, 0.6 / 3 = 0.2, 0.9 / 10 = 0.09
    policy = greedy()
    policy.reset(0)
    assert policy.act(observed) == 0
    assert policy.trace() == {gain: pytest.approx(0.5), "travel": pytest.approx(0.5)}
    observed["candidate_gains"][1, 0] = 0.9  # 0.3
    assert policy.act(observed) == 1
    observed["candidate_gains"][:, 0] = 0.0  # everything covered: the nearest
    assert policy.act(observed) == 0


def test_gains_are_found_by_name_whatever_their_order(rng: np.random.Generator) -> None:
    observed = observation(rng, gains=3)
    policy = PixelOnly()
    policy.bind(("hole_area", "other", "pixel"))
    np.testing.assert_array_equal(policy.gain(observed, "pixel"), observed["candidate_gains"][:, 2])
    with pytest.raises(ValueError, match=r"PixelOnly needs the gains \['pixel'\]"):
        policy.bind(("hole_area",))


def test_travel_discount_best_valid_and_nearest_new(rng: np.random.Generator) -> None:
    observed = observation(rng, rows=3, valid=2)
    observed["candidates"][:, CANDIDATE_FEATURES.index("frames")] = [0.0, 5.0, 45.0]
    np.testing.assert_allclose(travel_discount(observed), [1.0, 0.5, 0.1], rtol=1e-6)
    assert best_valid(np.array([1.0, 1.0, 5.0]), observed) == 0
    observed["candidates"][:, CANDIDATE_FEATURES.index("revisit")] = [1.0, 1.0, 0.0]
    assert nearest_new(observed) == 0  # both revisits: row 2 is masked
    observed["candidates"][1, CANDIDATE_FEATURES.index("revisit")] = 0.0
    assert nearest_new(observed) == 1


def test_a_third_party_policy_registers_in_a_few_lines(rng: np.random.Generator) -> None:
    @POLICIES.register("nearest_for_this_test")
    class Nearest(Policy):
        def act(self, observation: dict[str, np.ndarray]) -> int:
            return best_valid(travel_discount(observation), observation)

    try:
        policy = POLICIES.get("nearest_for_this_test")()
        observed = observation(rng)
        lengths = observed["candidates"][:8, CANDIDATE_FEATURES.index("frames")]
        assert policy.act(observed) == lengths.argmin()
    finally:
        del POLICIES._entries["nearest_for_this_test"]
