"""The network inside stable-baselines3: masks, spaces, saving."""

from __future__ import annotations

from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

from activestructure_gym.envs.observation import Table
from activestructure_gym.errors import InputError
from activestructure_gym.policies import make_policy
from activestructure_gym.policies.learned import CandidatePolicy, with_used_keys
from activestructure_gym.policies.learned.checkpoint import find_checkpoint, load_network, save_checkpoint
from activestructure_gym.policies.learned.config import USED_KEYS, NetworkConfig
from activestructure_gym.policies.learned.sb3 import CandidateHeads
from tests.policies.learned.toys import FEATURES, RandomCandidates

Algorithm = tuple[type[OnPolicyAlgorithm], type[CandidateHeads]]


def maskable() -> Algorithm:
    contrib = pytest.importorskip("sb3_contrib", reason="sb3-contrib is not installed")
    from activestructure_gym.policies.learned import MaskableCandidatePolicy

    return contrib.MaskablePPO, MaskableCandidatePolicy


@pytest.fixture(params=["PPO", "MaskablePPO"])
def algorithm(request: pytest.FixtureRequest) -> Algorithm:
    """Ours, and the one that brings masks of its own."""
    return (PPO, CandidatePolicy) if request.param == "PPO" else maskable()


@pytest.fixture
def model(algorithm: Algorithm) -> OnPolicyAlgorithm:
    torch.set_num_threads(1)
    kind, policy = algorithm
    env = RandomCandidates(images=True)
    return kind(policy, env, n_steps=64, batch_size=32, n_epochs=2, seed=0, device="cpu")  # type: ignore[call-arg]


def test_it_learns_on_an_environment_of_ours(algorithm: Algorithm) -> None:
    torch.set_num_threads(1)
    kind, policy = algorithm
    small = {"sensor": {"width": 48, "height": 27}, "views": {"max_candidates": 12}}
    env = gym.make(
        "activestructure_gym:ActiveStructure/Room-v0", scene="box", preset="fast", config=small, frame_budget=30
    )
    model = kind(policy, with_used_keys(env), n_steps=8, batch_size=8, n_epochs=1, seed=0, device="cpu")  # type: ignore[call-arg]
    before = {name: value.clone() for name, value in model.policy.network.state_dict().items()}
    assert model.policy.network.config.features == ("pixel",)  # as the env says
    model.learn(24)
    after = model.policy.network.state_dict()
    assert all(torch.isfinite(value).all() for value in after.values())
    assert not all(torch.equal(before[name], value) for name, value in after.items())


def test_masks_of_another_close_more_rows(make_observation) -> None:
    kind, policy = maskable()
    model = kind(policy, RandomCandidates(), n_steps=8, batch_size=8, seed=0, device="cpu")
    observation = {key: np.float32(value) for key, value in make_observation(valid=9).items()}
    valid = observation["action_mask"] == 1
    fewer = valid.copy()
    fewer[model.predict(observation, deterministic=True)[0]] = False
    for masks, open_rows in ((fewer, fewer), (np.ones(16, bool), valid)):
        drawn = {int(model.predict(observation, action_masks=masks)[0]) for _ in range(100)}
        assert drawn == set(np.flatnonzero(open_rows))


def test_no_masked_row_sampled_or_greedy_even_with_images_in_the_observation(model: OnPolicyAlgorithm) -> None:
    model.learn(192)  # the env checks 192 sampled actions
    env = model.get_env()
    assert env is not None
    observation = env.reset()
    for deterministic in (True, False) * 20:
        action, _ = model.predict(observation, deterministic=deterministic)
        observation, *_ = env.step(action)


def test_entropy_is_that_of_the_valid_rows(model: OnPolicyAlgorithm, make_observation) -> None:
    for valid in (1, 4):
        tensors = {k: torch.as_tensor(v[None]).float() for k, v in make_observation(valid=valid).items()}
        tensors["rgb"] = torch.zeros(1, 3, 4, 6)
        entropy = float(model.policy.get_distribution(tensors).entropy().detach())
        assert entropy == pytest.approx(np.log(valid), abs=1e-2)  # nearly equal scores at the beginning


def test_saved_by_stable_baselines3_and_by_us(model: OnPolicyAlgorithm, tmp_path: Path, make_observation) -> None:
    model.learn(64)
    model.save(tmp_path / "model.zip")
    again = type(model).load(tmp_path / "model.zip", device="cpu")
    observation = {key: np.float32(value) for key, value in make_observation().items()}
    observation["rgb"] = np.zeros((3, 4, 6), np.uint8)
    for deterministic in (True, False):
        torch.manual_seed(0)
        one, _ = model.predict(observation, deterministic=deterministic)
        torch.manual_seed(0)
        other, _ = again.predict(observation, deterministic=deterministic)
        assert one == other

    assert isinstance(model.policy, CandidateHeads)
    save_checkpoint(tmp_path / "ours.safetensors", model.policy.network, {})
    loaded = load_network(tmp_path / "ours.safetensors")
    tensors = {key: torch.as_tensor(observation[key][None]) for key in USED_KEYS}
    with torch.no_grad():
        assert torch.equal(loaded(tensors)[0], model.policy.network(tensors)[0])
        greedy, _ = model.predict(observation, deterministic=True)
        assert int(loaded(tensors)[0].argmax()) == int(greedy)


def test_a_policy_begins_from_a_checkpoint(model: OnPolicyAlgorithm, tmp_path: Path) -> None:
    policy = model.policy
    assert isinstance(policy, CandidateHeads)
    save_checkpoint(tmp_path / "start.safetensors", policy.network, {})
    kept = {name: value.clone() for name, value in policy.network.state_dict().items()}
    model.learn(64)
    assert not all(torch.equal(kept[name], value) for name, value in policy.network.state_dict().items())
    policy.begin_from(tmp_path / "start")
    assert all(torch.equal(kept[name], value) for name, value in policy.network.state_dict().items())
    other = type(policy.network)(NetworkConfig(features=("a", "b", "c")))
    save_checkpoint(tmp_path / "other.safetensors", other, {})
    with pytest.raises(InputError, match="another network"):
        policy.begin_from(tmp_path / "other")


def test_what_was_trained_takes_part_in_comparisons(model: OnPolicyAlgorithm, tmp_path: Path) -> None:
    assert isinstance(model.policy, CandidateHeads)
    place = tmp_path / "folder" / "mine.v2"
    assert model.policy.save_learned(place) == tmp_path / "folder" / "mine.v2.safetensors"
    assert model.policy.save_learned(tmp_path / "b.json") == find_checkpoint(tmp_path / "b.json")
    policy = make_policy(f"learned:{place}")
    assert policy.required_features == FEATURES
    env = RandomCandidates(images=True)
    policy.bind(env)  # type: ignore[arg-type]
    policy.reset(0)
    observation, _ = env.reset(seed=3)
    assert policy.act(observation) == int(model.predict(observation, deterministic=True)[0])
    with pytest.raises(InputError, match=r"may hold no '\?'"):
        model.policy.save_learned(tmp_path / "what?")
    with pytest.raises(InputError, match=r"becomes one by model.policy.save_learned\(PLACE\)"):
        make_policy(f"learned:{tmp_path / 'ppo.zip'}")


def test_what_is_saved_into_a_folder_that_is_there_is_what_plays_by_its_name(
    model: OnPolicyAlgorithm, tmp_path: Path
) -> None:
    assert isinstance(model.policy, CandidateHeads)
    run = tmp_path / "run"  # as `asg train` leaves it, with another network
    save_checkpoint(run / "best.safetensors", type(model.policy.network)(NetworkConfig(features=("a", "b", "c"))), {})
    for place in (run, tmp_path / "empty.v2", tmp_path / "called.json"):
        place.mkdir(exist_ok=True)
        assert model.policy.save_learned(place) == place / "best.safetensors" == find_checkpoint(place)
        assert make_policy(f"learned:{place}").required_features == FEATURES
        assert not place.with_name(f"{place.name}.safetensors").exists()


def test_unused_entries_can_be_dropped() -> None:
    env = with_used_keys(RandomCandidates(images=True))
    assert set(env.observation_space.spaces) == set(USED_KEYS) == set(env.reset(seed=0)[0])


def test_what_is_no_observation_of_ours_is_one_sentence() -> None:
    flat = gym.wrappers.FlattenObservation(RandomCandidates())
    for use in (with_used_keys, lambda env: PPO(CandidatePolicy, env)):
        with pytest.raises(InputError, match="this one is a Box without entries: use an env of this package"):
            use(flat)
    some = gym.wrappers.FilterObservation(RandomCandidates(), ["budget"])
    with pytest.raises(InputError, match="the observation lacks pose, candidates, "):
        with_used_keys(some)


def test_a_mask_that_a_wrapper_has_scaled_is_refused() -> None:
    env = VecNormalize(DummyVecEnv([lambda: with_used_keys(RandomCandidates())]))
    with pytest.raises(InputError, match="action_mask holds other numbers than 0 and 1"):
        PPO(CandidatePolicy, env, n_steps=8, batch_size=8).learn(8)


@pytest.mark.parametrize("features", [("a", "b", "c"), ("a", "b"), tuple(reversed(FEATURES))])
def test_a_network_for_other_features_is_refused_even_if_there_are_as_many(features: tuple[str, ...]) -> None:
    described = {"network": NetworkConfig(features=features).as_dict()}
    with pytest.raises(
        InputError,
        match=rf"needs the features \({', '.join(features)}\), but the env offers \(pixel, hole_area\): make",
    ):
        PPO(CandidatePolicy, RandomCandidates(), policy_kwargs=described)


def test_columns_without_names_are_no_gains() -> None:
    env = RandomCandidates()
    env.observation_space["candidate_features"] = gym.spaces.Box(-1e4, 1e7, (16, 2), np.float32)
    with pytest.raises(InputError, match="has no names for the columns of candidate_features"):
        PPO(CandidatePolicy, env)
    described = PPO(CandidatePolicy, env, policy_kwargs={"network": NetworkConfig(features=FEATURES).as_dict()})
    assert described.policy.network.config.features == FEATURES
    with pytest.raises(InputError, match=r"the env offers \(2 features\)"):
        PPO(CandidatePolicy, env, policy_kwargs={"network": NetworkConfig(features=("a", "b", "c")).as_dict()})


def test_a_stored_model_is_not_loaded_onto_other_gains(model: OnPolicyAlgorithm, tmp_path: Path) -> None:
    model.save(tmp_path / "model.zip")
    type(model).load(tmp_path / "model.zip", env=RandomCandidates(images=True), device="cpu")
    other = RandomCandidates(images=True)
    table = other.observation_space["candidate_features"]
    other.observation_space["candidate_features"] = Table(tuple(reversed(FEATURES)), table.low, table.high)
    with pytest.raises(ValueError, match="Observation spaces do not match"):
        type(model).load(tmp_path / "model.zip", env=other, device="cpu")
