"""A checkpoint as a policy: found by name, equal after saving, never a masked row, and light until it decides."""

from __future__ import annotations

import json
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file

from activestructure_gym.errors import InputError
from activestructure_gym.policies import POLICIES
from activestructure_gym.policies.learned import SHIPPED, Learned, learned_from
from activestructure_gym.policies.learned.checkpoint import find_checkpoint, load_network, save_checkpoint
from activestructure_gym.policies.learned.config import USED_KEYS, NetworkConfig
from activestructure_gym.policies.learned.network import CandidateNetwork, as_tensors
from tests.policies.binding import bound


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory: pytest.TempPathFactory) -> Path:
    torch.manual_seed(3)
    network = CandidateNetwork(NetworkConfig())
    with torch.no_grad():
        network.scorer[-1].weight.normal_()
    weights = tmp_path_factory.mktemp("run") / "best.safetensors"
    save_checkpoint(weights, network, {"method": "none"})
    return weights


def test_saved_and_loaded_is_equal_to_the_last_bit(checkpoint: Path, tmp_path: Path, make_observation) -> None:
    network = load_network(checkpoint)
    save_checkpoint(tmp_path / "again.safetensors", network, {})
    tensors = as_tensors({key: value[None] for key, value in make_observation().items()})
    with torch.no_grad():
        for one, other in zip(network(tensors), load_network(tmp_path / "again.safetensors")(tensors)):
            assert torch.equal(one, other)
    assert json.loads(checkpoint.with_suffix(".json").read_text())["trained"] == {"method": "none"}


def test_found_by_every_form_of_its_name(checkpoint: Path) -> None:
    folder = checkpoint.parent
    forms = (checkpoint, folder, checkpoint.with_suffix(""), checkpoint.with_suffix(".json"))
    kinds = [POLICIES.get(f"learned:{place}") for place in forms]
    assert {kind.spec for kind in kinds} == {kinds[0].spec}
    assert kinds[0].required_features == ("pixel", "hole_area")
    assert POLICIES.get(kinds[0].spec).spec == kinds[0].spec
    with pytest.raises(InputError, match="no file"):
        POLICIES.get(f"learned:{folder / 'other'}")


def test_a_date_after_an_at_sign_in_a_file_name_is_no_checksum(checkpoint: Path, tmp_path: Path) -> None:
    for suffix in (".safetensors", ".json"):
        (tmp_path / f"ppo@20261128{suffix}").write_bytes(checkpoint.with_suffix(suffix).read_bytes())
    found = learned_from(str(tmp_path / "ppo@20261128"))
    assert found.checkpoint == (tmp_path / "ppo@20261128.safetensors").resolve()
    assert learned_from(found.spec.removeprefix("learned:")).spec == found.spec


def test_our_own_ships_with_the_package() -> None:
    kind = POLICIES.get("learned")
    assert (
        kind.spec == "learned"
        and kind.checkpoint == SHIPPED
        and set(kind.required_features) == {"pixel", "hole_area", "unknown_volume", "unknown_volume_way"}
    )
    assert sum(path.stat().st_size for path in SHIPPED.parent.iterdir()) < 2_000_000
    told = json.loads(SHIPPED.with_suffix(".json").read_text())["trained"]
    assert told["configuration"]["seed"] == 0 and "validation/normalised" in told["log"]


def test_a_changed_checkpoint_is_another_policy(checkpoint: Path, tmp_path: Path) -> None:
    for suffix in (".safetensors", ".json"):
        (tmp_path / f"copy{suffix}").write_bytes(checkpoint.with_suffix(suffix).read_bytes())
    spec = POLICIES.get(f"learned:{tmp_path / 'copy'}").spec
    network = load_network(tmp_path / "copy.safetensors")
    with torch.no_grad():
        network.scorer[-1].bias.add_(1.0)
    save_checkpoint(tmp_path / "copy.safetensors", network, {})
    with pytest.raises(InputError, match="has changed"):
        POLICIES.get(spec)
    assert POLICIES.get(f"learned:{tmp_path / 'copy'}").spec != spec


def test_damaged_files_are_told(checkpoint: Path, tmp_path: Path) -> None:
    (tmp_path / "a.safetensors").write_bytes(b"nothing")
    (tmp_path / "a.json").write_bytes(checkpoint.with_suffix(".json").read_bytes())
    with pytest.raises(InputError, match="not a whole safetensors file.*; its JSON describes other weights, or one of"):
        load_network(find_checkpoint(tmp_path / "a"))
    for content in (b"{}", b"", b"\xff", b"[" * 100_000, b"[]"):
        (tmp_path / "a.json").write_bytes(content)
        with pytest.raises(InputError, match="cannot be read as the description of a checkpoint") as error:
            load_network(find_checkpoint(tmp_path / "a"))
        assert len(str(error.value).splitlines()) == 1


@pytest.mark.parametrize("dtype", [torch.float64, torch.float16, torch.int32, torch.bool, torch.complex64])
def test_weights_of_another_width_or_kind_are_refused(checkpoint: Path, tmp_path: Path, dtype: torch.dtype) -> None:
    weights = described(checkpoint, tmp_path)
    tensors = load_file(weights)
    name = next(iter(tensors))
    save_file(tensors | {name: tensors[name].to(dtype)}, weights)
    with pytest.raises(InputError, match=f"as '{name}', expected F32"):
        load_network(weights)


def described(checkpoint: Path, place: Path, **changes: object) -> Path:
    """The checkpoint with another description of its network."""
    content = json.loads(checkpoint.with_suffix(".json").read_text())
    content["network"] |= changes
    (place / "b.json").write_text(json.dumps(content))
    (place / "b.safetensors").write_bytes(checkpoint.read_bytes())
    return place / "b.safetensors"


@pytest.mark.parametrize(
    "changes, words",
    [
        ({"planes": 100_000}, "planes of the network must be a whole number from 1 to 1024, got 100000"),
        ({"candidates": 2**40}, "candidates of the network must be a whole number from 1 to 1024"),
        ({"rounds": 10**9}, "rounds of the network must be a whole number from 0 to 16"),
        ({"features": 5}, "a list of features by name, got 5"),
        ({"features": "pixel"}, "a list of features by name, got 'pixel'"),
        ({"features": ["pixel"] * 65}, "1 to 64 features, got 65"),
        ({"features": ["os:system"]}, "b.json' names the feature 'os:system', and to load it would run code"),
        ({"more": 1}, "a network is described by"),
    ],
)
def test_a_network_that_cannot_be_is_not_built(checkpoint: Path, tmp_path: Path, changes, words) -> None:
    weights = described(checkpoint, tmp_path, **changes)
    with pytest.raises(InputError, match=words):
        POLICIES.get(f"learned:{weights}")
    with pytest.raises(InputError, match=words):
        load_network(weights)


def test_weights_of_other_sizes_are_not_read(checkpoint: Path, tmp_path: Path) -> None:
    weights = described(checkpoint, tmp_path, candidates=1024, planes=1024)
    with pytest.raises(InputError, match=r"the tensor 'candidate_in.0.bias' has shape \(48,\), expected \(1024,\)"):
        load_network(weights)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_weights_that_are_not_finite_are_refused(checkpoint: Path, tmp_path: Path, value: float) -> None:
    network = load_network(checkpoint)
    with torch.no_grad():
        network.scorer[-1].bias.fill_(value)
    save_checkpoint(tmp_path / "c.safetensors", network, {})
    with pytest.raises(InputError, match="holds numbers in 'scorer.2.bias' that are not finite"):
        load_network(tmp_path / "c.safetensors")


def test_a_file_that_is_too_large_is_not_read(checkpoint: Path, tmp_path: Path) -> None:
    weights = described(checkpoint, tmp_path)
    with open(weights, "r+b") as file:
        file.truncate((256 << 20) + 1)
    with pytest.raises(InputError, match="has 268,435,457 bytes, a checkpoint has at most 268,435,456"):
        POLICIES.get(f"learned:{weights}")


def test_never_a_masked_row_deterministic_and_picklable(checkpoint: Path, make_observation) -> None:
    first = bound(POLICIES.get(f"learned:{checkpoint}")())
    assert isinstance(first, Learned)
    first.reset(0)
    second = pickle.loads(pickle.dumps(first))
    for valid in (1, 2, 9, 16):
        observation = make_observation(valid=valid)
        choice = first.act(observation)
        assert isinstance(choice, int) and observation["action_mask"][choice] == 1
        assert second.act(observation) == choice
        json.dumps(first.trace(), allow_nan=False)
    with pytest.raises(ValueError, match="no candidate is valid"):
        first.act(make_observation(valid=0))


def test_gains_are_found_by_name(checkpoint: Path, make_observation) -> None:
    policy, other = bound(POLICIES.get(f"learned:{checkpoint}")()), POLICIES.get(f"learned:{checkpoint}")()
    observation = make_observation()
    with pytest.raises(InputError, match=r"is not bound, so .* call policy.bind\(env\)"):
        other.act(observation)
    other.bind(("hole_area", "structure", "pixel"))
    pixel, hole_area = observation["candidate_features"].T
    wider = observation | {"candidate_features": np.stack([hole_area, pixel * 7, pixel], axis=1)}
    np.testing.assert_array_equal(other.scores(wider), policy.scores(observation))


def test_no_ground_truth_is_read_and_nothing_heavy_loaded(checkpoint: Path) -> None:
    assert not {"coverage", "oracle", "reward"} & {word for key in USED_KEYS for word in key.split("_")}
    code = (
        "import sys; from activestructure_gym.policies import POLICIES;"
        f"POLICIES.get({f'learned:{checkpoint}'!r})();"
        "print([m for m in ('torch', 'stable_baselines3', 'numba', 'safetensors') if m in sys.modules])"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"
