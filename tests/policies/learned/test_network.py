"""Laws of the candidate-set network: renumbering, masks, frames of reference, sizes."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from activestructure_gym.envs.observation import plane_columns
from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.training.config import TrainingConfig, WorldConfig
from activestructure_gym.policies.learned import inputs
from activestructure_gym.policies.learned.config import PLANE_KEYS, USED_KEYS, NetworkConfig
from activestructure_gym.policies.learned.network import MASKED, CandidateNetwork, as_tensors, masked_pool
from activestructure_gym.policies.learned.policy import largest_planes


@pytest.fixture(scope="module")
def network() -> CandidateNetwork:
    torch.manual_seed(0)
    made = CandidateNetwork(NetworkConfig())
    with torch.no_grad():  # the last layers begin near 0, where every law would hold
        for head in (made.scorer, made.critic):
            head[-1].weight.normal_()
    return made.eval()


def run(network: CandidateNetwork, observation: dict[str, np.ndarray]) -> tuple[np.ndarray, float]:
    with torch.no_grad():
        scores, value = network(as_tensors({key: observation[key][None] for key in USED_KEYS}))
    return scores[0].numpy(), float(value[0])


def test_size_and_sensitivity(network, make_observation) -> None:
    assert 10_000 <= sum(parameter.numel() for parameter in network.parameters()) <= 40_000
    scores, _ = run(network, observation := make_observation())
    assert np.ptp(scores[observation["action_mask"] > 0]) > 1e-2  # or the laws below would hold for a constant


def test_renumbering_candidates_renumbers_the_scores(network, make_observation, rng) -> None:
    observation = make_observation(rows=64, valid=40, planes=20)
    scores, value = run(network, observation)
    order = rng.permutation(64)
    by_row = ("candidates", "candidate_features", "action_mask", "candidate_planes")
    moved, moved_value = run(network, observation | {key: observation[key][order] for key in by_row})
    np.testing.assert_allclose(moved, scores[order], atol=1e-4)
    assert moved_value == pytest.approx(value, abs=1e-4)


def test_renumbering_planes_changes_nothing(network, make_observation, rng) -> None:
    observation = make_observation(planes=20)
    order = rng.permutation(20)
    moved = observation | {key: observation[key][order] for key in ("plane_features", "plane_mask")}
    moved["plane_edges"] = observation["plane_edges"][np.ix_(order, order)]
    moved["candidate_planes"] = observation["candidate_planes"][:, order]
    np.testing.assert_allclose(run(network, moved)[0], run(network, observation)[0], atol=1e-4)


def test_without_use_planes_a_scene_with_planes_looks_like_one_without(make_observation) -> None:
    torch.manual_seed(0)
    blind = CandidateNetwork(NetworkConfig(use_planes=False))
    with torch.no_grad():
        blind.scorer[-1].weight.normal_()
    sees = CandidateNetwork(NetworkConfig())
    sees.load_state_dict(blind.state_dict())
    observation = make_observation(planes=20)
    bare = observation | {key: np.zeros_like(observation[key]) for key in PLANE_KEYS}
    np.testing.assert_array_equal(run(blind, observation)[0], run(sees, bare)[0])
    assert not np.allclose(run(blind, observation)[0], run(sees, observation)[0])
    described = blind.config.as_dict()
    assert NetworkConfig.from_dict(described) == blind.config
    assert NetworkConfig.from_dict({k: v for k, v in described.items() if k != "use_planes"}) == NetworkConfig()
    with pytest.raises(InputError, match="use_planes"):
        NetworkConfig(use_planes=1)


def test_more_empty_rows_change_nothing(network, make_observation) -> None:
    observation = make_observation(rows=16, planes=8)
    scores, value = run(network, observation)

    def wider(key: str, by: tuple[tuple[int, int], ...]) -> np.ndarray:
        return np.pad(observation[key], by)

    rows = {key: wider(key, ((0, 5), (0, 0))) for key in ("candidates", "candidate_features")}
    rows["action_mask"] = wider("action_mask", ((0, 5),))
    rows["plane_features"] = wider("plane_features", ((0, 3), (0, 0)))
    rows["plane_mask"] = wider("plane_mask", ((0, 3),))
    rows["plane_edges"] = wider("plane_edges", ((0, 3), (0, 3)))
    rows["candidate_planes"] = wider("candidate_planes", ((0, 5), (0, 3)))
    wide, wide_value = run(network, observation | rows)
    np.testing.assert_allclose(wide[:16], scores, atol=1e-4)
    assert (wide[16:] == MASKED).all()
    assert wide_value == pytest.approx(value, abs=1e-4)


def rotation(angle: float) -> np.ndarray:
    return np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])


def test_a_turned_and_moved_world_looks_the_same(network, make_observation) -> None:
    observation = make_observation()
    angle, shift = 1.1, np.array([3.0, -2.0, 0.5])
    turn = rotation(angle)
    moved = {key: value.copy() for key, value in observation.items()}
    there = observation["action_mask"] > 0
    moved["candidates"][there, :3] = observation["candidates"][there, :3] @ turn.T + shift
    moved["candidates"][there, 3:6] = observation["candidates"][there, 3:6] @ turn.T
    table, present = moved["plane_features"], observation["plane_mask"] > 0
    table[present, :3] = table[present, :3] @ turn.T
    table[present, 3] -= table[present, :3] @ shift
    table[present, 4:7] = table[present, 4:7] @ turn.T + shift
    half = np.array([np.cos(angle / 2), 0, 0, np.sin(angle / 2)])
    w, x, y, z = observation["pose"][3:]
    moved["pose"][:3] = turn @ observation["pose"][:3] + shift
    moved["pose"][3:] = [
        half[0] * w - half[3] * z, half[0] * x - half[3] * y, half[0] * y + half[3] * x, half[0] * z + half[3] * w
    ]  # fmt: skip
    np.testing.assert_allclose(run(network, moved)[0], run(network, observation)[0], atol=1e-3)


def test_neighbours_are_heard_of_and_strangers_not(network, make_observation) -> None:
    observation = make_observation(planes=5)
    edges = np.zeros((5, 5), np.float32)
    edges[0, 1] = edges[1, 0] = 0.2  # 0 - 1, and 2 apart
    seen = np.zeros_like(observation["candidate_planes"])
    seen[:, 0] = observation["action_mask"]
    observation |= {"plane_edges": edges, "candidate_planes": seen}

    def summaries(changed: int) -> np.ndarray:
        table = observation["plane_features"].copy()
        table[changed, -1] += 5.0
        tensors = as_tensors({key: value[None] for key, value in (observation | {"plane_features": table}).items()})
        with torch.no_grad():
            links = inputs.plane_links(tensors)
            planes = torch.relu(network.plane_in(inputs.plane_inputs(tensors)))
            for layer in network.rounds:
                planes = torch.relu(layer(torch.cat([planes, links @ planes], dim=-1)))
        return planes[0, 0].numpy()

    before = summaries(3)  # a stranger's change
    np.testing.assert_array_equal(summaries(2), before)
    assert np.abs(summaries(1) - before).max() > 1e-5


def test_pooling_and_links_by_hand() -> None:
    tokens = torch.tensor([[[1.0, -2.0], [3.0, -4.0], [9.0, 9.0]]])
    pooled = masked_pool(tokens, torch.tensor([[1.0, 1.0, 0.0]]))
    assert pooled.tolist() == [[2.0, -3.0, 3.0, -2.0]]
    assert masked_pool(tokens, torch.zeros(1, 3)).tolist() == [[0.0] * 4]
    weight = float(-np.log(0.5))  # exp(-w) = 0.5
    observation = {
        "plane_edges": torch.tensor([[[0.0, weight, 0.0], [weight, 0.0, 0.0], [0.0, 0.0, 0.0]]]),
        "plane_mask": torch.tensor([[1.0, 1.0, 0.0]]),
    }
    links = inputs.plane_links(observation)[0]
    np.testing.assert_allclose(links, [[2 / 3, 1 / 3, 0], [1 / 3, 2 / 3, 0], [0, 0, 0]], atol=1e-6)


def test_gains_by_hand() -> None:
    sizes = inputs.feature_sizes(torch.tensor([0.0, 0.999, -0.999])).tolist()
    assert sizes == pytest.approx([0, np.log(1000) / 7, -np.log(1000) / 7], abs=1e-4)


def test_inputs_stay_small_whatever_the_scene(make_observation) -> None:
    observation = make_observation()
    observation["candidates"][observation["action_mask"] > 0, :3] = 1000.0
    observation["candidates"][observation["action_mask"] > 0, 6:8] = [1000.0, 10_000.0]
    observation["plane_features"][0, 7:10] = [10_000.0, 4e6, 1e5]
    tensors = as_tensors({key: value[None] for key, value in observation.items()})
    for made in (inputs.candidate_inputs, inputs.plane_inputs, inputs.global_inputs):
        values = made(tensors)
        assert torch.isfinite(values).all() and values.abs().max() < 5.0


def test_what_never_varies_in_the_fast_preset_counts_nothing_until_it_is_learnt(make_observation) -> None:
    """Height above the camera and revisit: random weights for them would be noise where they do vary."""
    torch.manual_seed(0)
    fresh = CandidateNetwork(NetworkConfig())
    with torch.no_grad():
        fresh.scorer[-1].weight.normal_()
    observation = make_observation()
    there = observation["action_mask"] > 0
    changed = observation["candidates"].copy()
    changed[there, 8] = 1 - changed[there, 8]
    changed[there, 2] += 3.0
    scores, value = run(fresh, observation)
    moved, moved_value = run(fresh, observation | {"candidates": changed})
    np.testing.assert_array_equal(moved, scores)
    assert moved_value == value
    tensors = as_tensors({key: value[None] for key, value in observation.items()})
    scores = fresh(tensors)[0][0]
    scores[torch.as_tensor(there)].pow(2).sum().backward()
    assert (fresh.candidate_in[0].weight.grad[:, list(inputs.CONSTANT_IF_FAST)].abs().max(0).values > 0).all()


def test_a_critic_that_knows_nothing_bends_nothing(network, make_observation) -> None:
    network.zero_grad()
    tensors = as_tensors({key: value[None] for key, value in make_observation().items()})
    network(tensors)[1].sum().backward()
    touched = {name.split(".")[0] for name, p in network.named_parameters() if p.grad is not None and p.grad.any()}
    assert touched == {"critic"}


def test_the_configuration_is_checked_and_returns_from_json() -> None:
    config = NetworkConfig(features=("pixel",), planes=8)
    assert NetworkConfig.from_dict(config.as_dict()) == config
    for wrong in ({"features": ()}, {"planes": 0}, {"rounds": 1.5}):
        with pytest.raises(InputError):
            NetworkConfig(**wrong)
    with pytest.raises(InputError, match="is described by"):
        NetworkConfig.from_dict({"features": ["pixel"]})


def test_of_more_planes_than_in_training_the_largest_are_read(network, make_observation, rng) -> None:
    observation = make_observation(planes=20)
    (area,) = plane_columns("area")
    observation["plane_features"][:20, area] = rng.permutation(20) + 1.0
    fewer = largest_planes(observation, 5)
    assert sorted(fewer["plane_features"][:, area]) == [16.0, 17.0, 18.0, 19.0, 20.0]
    rows = np.flatnonzero(observation["plane_features"][:, area] > 15.5)
    np.testing.assert_array_equal(fewer["plane_edges"], observation["plane_edges"][np.ix_(rows, rows)])
    np.testing.assert_array_equal(fewer["candidate_planes"], observation["candidate_planes"][:, rows])
    assert largest_planes(observation, len(observation["plane_mask"])) is observation
    assert TrainingConfig(world=WorldConfig(max_planes=12)).network().max_planes == 12
    padded = largest_planes(observation, 20)  # nothing but empty rows is left out
    np.testing.assert_allclose(run(network, padded)[0], run(network, observation)[0], atol=1e-5)
