"""An env and a policy from one call, and what becomes of one that was never bound."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.policies import POLICIES, Policy, make_env_and_policy
from activestructure_gym.policies.hole_area import HoleArea
from activestructure_gym.policies.pixel_only import PixelOnly
from activestructure_gym.scenes import load_scene
from activestructure_gym.worlds.simulated_world import SimulatedRobot

ROOM = "activestructure_gym:ActiveStructure/Room-v0"
SMALL: dict[str, Any] = {
    "preset": "fast",
    "frame_budget": 60,
    "config": {"sensor": {"width": 64, "height": 36}, "views": {"max_candidates": 24}},
}


def played(env: gym.Env[Any, Any], policy: Policy) -> list[int]:
    """The rows it goes to in an episode."""
    policy.reset(seed=0)
    observation, _ = env.reset(seed=0)
    chosen, ended = [], False
    while not ended:
        chosen.append(policy.act(observation))
        observation, _, terminated, truncated, _ = env.step(chosen[-1])
        ended = terminated or truncated
    env.close()
    return chosen


@pytest.fixture(scope="module")
def alone() -> dict[str, list[int]]:
    """What two policies choose on envs of their own."""
    choices = {name: played(*make_env_and_policy(name, "box", **SMALL)) for name in ("pixel_only", "hole_area")}
    assert choices["pixel_only"] != choices["hole_area"]
    return choices


def test_an_unbound_policy_refuses_instead_of_playing_as_another() -> None:
    with pytest.raises(InputError, match=r"^HoleArea is not bound, so .* make_env_and_policy\(\.\.\.\)$"):
        played(gym.make(ROOM, scene="box", **SMALL), HoleArea())
    with pytest.raises(InputError, match="^HoleArea needs the features hole_area, and the env offers pixel"):
        HoleArea().bind(gym.make(ROOM, scene="box", **SMALL))


@pytest.mark.parametrize(
    "features", [("hole_area", "pixel"), ("pixel", "hole_area"), ("structure", "hole_area", "pixel")]
)
def test_a_bound_policy_plays_as_it_does_alone_whatever_else_is_on_offer(
    features: tuple[str, ...], alone: dict[str, list[int]]
) -> None:
    for name, choices in alone.items():
        env, policy = gym.make(ROOM, scene="box", features=features, **SMALL), POLICIES.get(name)()
        policy.bind(env)
        assert played(env, policy) == choices


def test_a_name_a_class_and_a_policy_are_the_same(alone: dict[str, list[int]]) -> None:
    for given in (PixelOnly, PixelOnly(), "activestructure_gym.policies.pixel_only:PixelOnly"):
        assert played(*make_env_and_policy(given, scene="box", **SMALL)) == alone["pixel_only"]


def test_the_env_offers_what_is_asked_for_and_more_if_wanted() -> None:
    env, policy = make_env_and_policy("activestructure", "box", features=("pixel", "deficiency"), **SMALL)
    names = env.observation_space["candidate_features"].names  # type: ignore[index]
    assert names == (*policy.required_features, "pixel") == env.reset(seed=0)[1]["features"]
    assert make_env_and_policy("random", "box", **SMALL)[0].observation_space["candidate_features"].names == ()  # type: ignore[index]
    options = make_env_and_policy("active_gs?travel=shared", "box", **SMALL)[1]
    assert options.travel == "shared"  # type: ignore[attr-defined]


def test_scenes_and_envs_as_everywhere(tmp_path: Path) -> None:
    scene = load_scene("box?seed=3")
    for given in (scene, "box?seed=3", ["box?seed=3"]):
        env, _ = make_env_and_policy("random", given, **SMALL)
        env.reset(seed=0)
        assert env.unwrapped.reconstruction.scene.content_hash == scene.content_hash  # type: ignore[attr-defined]
    flat = "activestructure_gym:ActiveStructure/Apartment-v0"
    env, _ = make_env_and_policy("random", env_id=flat, rooms=2, max_episode_steps=3, render_mode="rgb_array")
    assert (env.spec.id, env.spec.max_episode_steps, env.render_mode) == (flat.split(":")[1], 3, "rgb_array")  # type: ignore[union-attr]
    with pytest.raises(InputError, match="Mesh-v0 needs a scene"):
        make_env_and_policy("random", env_id="activestructure_gym:ActiveStructure/Mesh-v0")


@pytest.mark.parametrize(
    ("policy", "options", "message"),
    [
        ("hole_aera", {}, "unknown policy 'hole_aera'; did you mean 'hole_area'?"),
        (Policy, {}, "a policy is given by its name, as a class derived from Policy that defines act(), or ready-made"),
        (dict, {}, "a policy is given by its name, as a class derived from Policy"),
        (None, {}, "a policy is given by its name, as a class derived from Policy"),
        ("pixel_only", {"features": "hole_area"}, "features must be a list of names, got 'hole_area'"),
        ("pixel_only", {"features": ["hole_aera"]}, "unknown feature 'hole_aera'"),
        ("pixel_only", {"features": [["pixel"]]}, "a feature is given by its name"),
        ("pixel_only", {"preset": "fsat"}, "unknown preset 'fsat'"),
    ],
)
def test_mistakes_are_said_in_one_sentence(policy: Any, options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as caught:
        make_env_and_policy(policy, "box", **{**SMALL, **options})
    assert message in str(caught.value) and "\n" not in str(caught.value)


def test_in_a_vector_env_one_binding_serves_every_row() -> None:
    options = {"scene": "box", "features": ("structure", "hole_area"), **SMALL}
    envs, policy = gym.make_vec(ROOM, num_envs=2, vectorization_mode="sync", **options), HoleArea()
    policy.bind(envs)
    observation, info = envs.reset(seed=[5, 6])
    assert info["features"].tolist() == [options["features"]] * 2
    single, other = make_env_and_policy("hole_area", "box", **SMALL)
    for row, seed in enumerate((5, 6)):
        alone, _ = single.reset(seed=seed)
        np.testing.assert_array_equal(observation["candidates"][row], alone["candidates"])
        assert policy.act({key: value[row] for key, value in observation.items()}) == other.act(alone)
    envs.close()


def test_a_world_stays_the_caller_s_if_the_policy_does_not_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(policy: HoleArea, env: object) -> None:
        raise InputError("does not fit")

    closed: list[str] = []
    world = SimulatedRobot("box", width=48, height=36)
    monkeypatch.setattr(SimulatedRobot, "close", lambda robot: closed.append("world"))
    monkeypatch.setattr(HoleArea, "bind", refuse)
    name = "simulated?scene=box&width=48&height=36"
    of_world: dict[str, Any] = {"env_id": "activestructure_gym:ActiveStructure/World-v0"}
    for given, released in (({"scene": world}, 0), (of_world | {"world": world}, 0), (of_world | {"world": name}, 1)):
        with pytest.raises(InputError, match="does not fit"):
            make_env_and_policy("hole_area", preset="fast", **given)
        assert len(closed) == released
