"""The network inside stable-baselines3: masks, spaces, saving."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from stable_baselines3 import PPO

from activestructure_gym.errors import InputError
from activestructure_gym.policies.learned import CandidatePolicy, with_used_keys
from activestructure_gym.policies.learned.checkpoint import load_network, save_checkpoint
from activestructure_gym.policies.learned.config import USED_KEYS, NetworkConfig
from tests.policies.learned.toys import RandomCandidates


@pytest.fixture
def model() -> PPO:
    torch.set_num_threads(1)
    env = RandomCandidates(images=True)
    return PPO(CandidatePolicy, env, n_steps=64, batch_size=32, n_epochs=2, seed=0, device="cpu")


def test_no_masked_row_sampled_or_greedy_even_with_images_in_the_observation(model: PPO) -> None:
    model.learn(192)  # the env checks 192 sampled actions
    env = model.get_env()
    assert env is not None
    observation = env.reset()
    for deterministic in (True, False) * 20:
        action, _ = model.predict(observation, deterministic=deterministic)
        observation, *_ = env.step(action)


def test_entropy_is_that_of_the_valid_rows(model: PPO, make_observation) -> None:
    for valid in (1, 4):
        tensors = {k: torch.as_tensor(v[None]).float() for k, v in make_observation(valid=valid).items()}
        tensors["rgb"] = torch.zeros(1, 3, 4, 6)
        entropy = float(model.policy.get_distribution(tensors).entropy().detach())
        assert entropy == pytest.approx(np.log(valid), abs=1e-2)  # nearly equal scores at the beginning


def test_saved_by_stable_baselines3_and_by_us(model: PPO, tmp_path: Path, make_observation) -> None:
    model.learn(64)
    model.save(tmp_path / "model.zip")
    again = PPO.load(tmp_path / "model.zip", device="cpu")
    observation = {key: np.float32(value) for key, value in make_observation().items()}
    observation["rgb"] = np.zeros((3, 4, 6), np.uint8)
    for deterministic in (True, False):
        torch.manual_seed(0)
        one, _ = model.predict(observation, deterministic=deterministic)
        torch.manual_seed(0)
        other, _ = again.predict(observation, deterministic=deterministic)
        assert one == other

    assert isinstance(model.policy, CandidatePolicy)
    save_checkpoint(tmp_path / "ours.safetensors", model.policy.network, {})
    loaded = load_network(tmp_path / "ours.safetensors")
    tensors = {key: torch.as_tensor(observation[key][None]) for key in USED_KEYS}
    with torch.no_grad():
        assert torch.equal(loaded(tensors)[0], model.policy.network(tensors)[0])
        greedy, _ = model.predict(observation, deterministic=True)
        assert int(loaded(tensors)[0].argmax()) == int(greedy)


def test_a_policy_begins_from_a_checkpoint(model: PPO, tmp_path: Path) -> None:
    policy = model.policy
    assert isinstance(policy, CandidatePolicy)
    save_checkpoint(tmp_path / "start.safetensors", policy.network, {})
    kept = {name: value.clone() for name, value in policy.network.state_dict().items()}
    model.learn(64)
    assert not all(torch.equal(kept[name], value) for name, value in policy.network.state_dict().items())
    policy.begin_from(tmp_path / "start")
    assert all(torch.equal(kept[name], value) for name, value in policy.network.state_dict().items())
    other = type(policy.network)(NetworkConfig(gains=("a", "b", "c")))
    save_checkpoint(tmp_path / "other.safetensors", other, {})
    with pytest.raises(InputError, match="another network"):
        policy.begin_from(tmp_path / "other")


def test_unused_entries_can_be_dropped() -> None:
    env = with_used_keys(RandomCandidates(images=True))
    assert set(env.observation_space.spaces) == set(USED_KEYS) == set(env.reset(seed=0)[0])
    with pytest.raises(InputError, match="offers 2"):
        PPO(CandidatePolicy, env, policy_kwargs={"network": NetworkConfig(gains=("a", "b", "c")).as_dict()})
