"""Contracts of every registered policy and feature on observations of a real episode: one for all, played once."""

from __future__ import annotations

import dataclasses
import inspect
import pickle
from collections.abc import Iterator
from typing import Any
from unittest import mock

import gymnasium as gym
import numpy as np
import pytest
import trimesh
from stable_baselines3.common.vec_env import DummyVecEnv

from activestructure_gym.envs import ReconstructionEnv
from activestructure_gym.envs.observation import CANDIDATE_COLUMNS, STAGE_COLUMNS
from activestructure_gym.errors import InputError
from activestructure_gym.features import FEATURES, FeatureContext, column_names, evaluate_features
from activestructure_gym.features.keyframe_information import KeyframeInformation
from activestructure_gym.mapping.keyframe_mapper import StepFollower
from activestructure_gym.policies import POLICIES, Policy, make_policy
from activestructure_gym.policies.candidates import Candidates
from activestructure_gym.policies.gauss_mi.reliability import DirectionalReliability
from activestructure_gym.scenes import Scene, SceneMesh
from activestructure_gym.scenes.raycaster import RayCaster

Observation = dict[str, np.ndarray]

NAMES = sorted(POLICIES)
SPECS = NAMES + [f"{n}?travel=shared" for n in NAMES if "travel" in inspect.signature(POLICIES.get(n)).parameters]
COLUMNS = column_names(FEATURES)
STEPS = 8  # until there are several places to go to


def make_scene() -> Scene:
    """A room with a table and a shelf; its arrays belong to the test."""
    room = trimesh.creation.box((6.0, 5.0, 2.5))
    room.invert()
    room.apply_translation((3.0, 2.5, 1.25))
    parts = [room.subdivide().subdivide()]
    for extents, place in (((0.8, 0.6, 0.7), (3.0, 1.0, 0.35)), ((0.3, 1.0, 1.6), (0.3, 2.2, 0.8))):
        part = trimesh.creation.box(extents)
        part.apply_translation(place)
        parts.append(part)
    mesh = trimesh.util.concatenate(parts)
    colors = np.random.default_rng(0).uniform(0.2, 0.9, (len(mesh.vertices), 3))
    return Scene(
        name="contracts",
        mesh=SceneMesh(
            vertices=mesh.vertices.astype(np.float32),
            faces=mesh.faces.astype(np.int32),
            colors=colors.astype(np.float32),
            uv=np.zeros((len(mesh.vertices), 2), np.float32),
            face_texture=np.full(len(mesh.faces), -1, np.int32),
        ),
        source="this test",
    )


class Untouchable:
    """Stands where ground truth was."""

    def __getattr__(self, name: str) -> Any:
        raise AssertionError(f"a score asked the ground truth for '{name}'")

    def close(self) -> None:
        """What the environment calls at its end."""


def swap_truth(env: ReconstructionEnv) -> None:
    """Another mesh in the same bounds, in place and as another scene, and a sensor that says whoever asks it."""
    scene = env.reconstruction.scene
    low, high = scene.bounds  # the workspace, which everybody is told
    crushed = np.where(scene.mesh.vertices > 0.5 * (low + high), high, low).astype(np.float32)
    other = dataclasses.replace(scene, mesh=dataclasses.replace(scene.mesh, vertices=crushed))
    assert np.array_equal(other.bounds, scene.bounds) and other.content_hash != scene.content_hash
    for name in ("raycaster", "free_space", "observable_surface"):
        other.__dict__[name] = Untouchable()
    scene.mesh.vertices[:] = crushed  # for whoever kept the old one
    scene.mesh.colors[:] = 0.5
    scene.__dict__["raycaster"] = RayCaster(crushed, scene.mesh.faces)
    env.reconstruction.scene = other
    env.reconstruction.sensor = Untouchable()  # type: ignore[assignment]
    env.reconstruction.world = Untouchable()  # type: ignore[assignment]


def scored_anew(env: ReconstructionEnv) -> Observation:
    """The observation of the present state, as if nothing had been asked of the mapper before.

    What features measure from keyframes (information, votes) is otherwise kept until the next mapping event.
    """
    mapper = env.reconstruction.mapper
    for make, kept in list(mapper.memory.items()):
        if not isinstance(kept, StepFollower):  # what follows steps cannot be measured anew
            del mapper.memory[make]
    env.reconstruction._refresh()
    return env.observation()


@dataclasses.dataclass
class Episode:
    """What an episode showed, and its last state scored again after the truth was swapped."""

    env: ReconstructionEnv
    played: list[Observation]
    observations: list[Observation]  # the last four
    context: FeatureContext
    swapped: Observation


@pytest.fixture(scope="module")
def episode() -> Iterator[Episode]:
    env = ReconstructionEnv(
        scene=make_scene(), preset="fast", features=COLUMNS, frame_budget=120,
        config={
            "sensor": {"width": 64, "height": 36},
            "views": {"max_candidates": 24, "max_revisits": 2},
        },
    )  # fmt: skip
    observation, _ = env.reset(seed=2)
    observations, rng = [observation], np.random.default_rng(0)
    for _ in range(STEPS):
        observation, *_ = env.step(int(rng.choice(np.flatnonzero(observation["action_mask"]))))
        observations.append(observation)
    reconstruction = env.reconstruction
    reconstruction.mapper.keyframe_psnr(renders=None)  # or what is measured anew could become another table
    scene, sensor = reconstruction.scene, reconstruction.sensor
    observations[-1] = scored_anew(env)
    swap_truth(env)
    measure, vote = KeyframeInformation._measure, DirectionalReliability._vote
    with (
        mock.patch.object(KeyframeInformation, "_measure", autospec=True, side_effect=measure) as measured,
        mock.patch.object(DirectionalReliability, "_vote", autospec=True, side_effect=vote) as voted,
    ):
        swapped = scored_anew(env)
    # Or what is compared would be what was kept. Measured are colours and depth.
    assert measured.call_count / 2 == voted.call_count == len(reconstruction.keyframe_indices)
    context = FeatureContext(
        mapper=reconstruction.mapper, volume=reconstruction.volume, planes=reconstruction.planes,
        camera=reconstruction.scoring_camera, bounds=scene.bounds, coverage_alpha=0.5, max_range=10.0,
        world_from_camera=reconstruction.candidates.world_from_camera, agent=reconstruction.agent,
    )  # fmt: skip
    yield Episode(env, observations, observations[-4:], context, swapped)
    reconstruction.sensor = sensor
    env.close()


def begun(spec: str) -> Policy:
    policy = make_policy(spec)
    policy.bind(COLUMNS)
    policy.reset(3)
    return policy


@pytest.mark.parametrize("spec", SPECS)
def test_valid_rows_only_the_same_ones_again_and_a_pickle_goes_on(spec: str, episode: Episode) -> None:
    first, second, third = begun(spec), begun(spec), begun(spec)
    for observation in episode.observations:
        before = pickle.dumps(observation)
        choice = first.act(observation)
        assert isinstance(choice, int) and observation["action_mask"][choice] == 1
        assert pickle.dumps(observation) == before
        assert second.act(observation) == choice
        third = pickle.loads(pickle.dumps(third))
        assert third.act(observation) == choice


def state(thing: Any) -> Any:
    """All that an object remembers, comparable; the note on the last choice apart."""
    if isinstance(thing, np.random.Generator):
        return thing.bit_generator.state
    if isinstance(thing, np.ndarray):
        return thing.shape, thing.tolist()
    if isinstance(thing, dict):
        return {key: state(value) for key, value in thing.items()}
    if hasattr(thing, "__dict__"):
        return {key: state(value) for key, value in vars(thing).items() if key != "_trace"}
    return thing


REMEMBERING = ("activegamer", "activeinr", "activesplat", "anm_s", "gs_planner", "naruto", "random")


@pytest.mark.parametrize("spec", SPECS)
def test_what_a_policy_remembers_goes_with_the_episode(spec: str, episode: Episode) -> None:
    policy, fresh, remembered = begun(spec), state(begun(spec)), False
    larger = {key: value.copy() for key, value in episode.played[-1].items()}  # whose views are far apart
    larger["candidate_features"][:, COLUMNS.index("gs_planner_volume")] += 0.5
    larger["candidates"][:, 0] += 5.0 * np.arange(len(larger["candidates"]))  # so that some are worth storing
    for observation in [*episode.played, larger]:
        policy.act(observation)
        remembered |= state(policy) != fresh
        again = pickle.loads(pickle.dumps(policy))
        again.reset(3)
        assert state(again) == fresh
    assert remembered or spec not in REMEMBERING


@pytest.mark.parametrize("spec", SPECS)
def test_a_masked_row_is_never_chosen_however_good_it_is(spec: str, episode: Episode) -> None:
    for observation in episode.observations[1:]:
        policy, closed = begun(spec), {key: value.copy() for key, value in observation.items()}
        for _ in range(3):  # each time the favourite is taken away
            choice = policy.act(closed)
            assert closed["action_mask"][choice] == 1
            closed["action_mask"][choice] = 0


@pytest.mark.parametrize("spec", NAMES)
def test_what_reset_returns_is_no_observation(spec: str, episode: Episode) -> None:
    with pytest.raises(InputError, match=r"got a tuple of 2 things.* observation, info = env.reset"):
        begun(spec).act((episode.observations[0], {}))


class Replay(gym.Env):
    """An env that shows recorded observations."""

    def __init__(self, episode: Episode) -> None:
        self.observation_space, self.action_space = episode.env.observation_space, episode.env.action_space
        self._shown, self._at = episode.observations, 0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Observation, dict]:
        super().reset(seed=seed)
        self._at = 0 if seed is None else seed % 2
        return self._shown[self._at], {}

    def step(self, action: int) -> tuple[Observation, float, bool, bool, dict]:
        assert self._shown[self._at]["action_mask"][action] == 1
        self._at += 1
        return self._shown[self._at], 0.0, False, False, {}


@pytest.mark.parametrize("kind", ["gymnasium", "stable-baselines3"])
def test_every_policy_runs_in_a_vector_env(kind: str, episode: Episode) -> None:
    makers = [lambda: Replay(episode)] * 2
    for spec in SPECS:
        envs: Any = DummyVecEnv(makers) if kind == "stable-baselines3" else gym.vector.SyncVectorEnv(makers)
        if kind == "stable-baselines3":
            envs.seed(0)  # the second env begins with the second observation
            batch = envs.reset()
        else:
            batch, _ = envs.reset(seed=0)
        together, alone = [begun(spec) for _ in range(2)], [begun(spec) for _ in range(2)]
        for step in range(2):
            rows = [{key: value[i] for key, value in batch.items()} for i in range(2)]
            actions = np.array([policy.act(row) for policy, row in zip(together, rows)])
            expected = [policy.act(episode.observations[step + i]) for i, policy in enumerate(alone)]
            assert actions.tolist() == expected, spec
            batch = envs.step(actions)[0]


@pytest.mark.parametrize("name", sorted(FEATURES))
def test_a_feature_keeps_its_bounds_and_has_the_columns_it_names(name: str, episode: Episode) -> None:
    feature, names = FEATURES.get(name), FEATURES.columns(name)
    assert feature.__doc__ and len(names) == len(set(names)) == len(feature.columns)
    for observation in episode.observations:
        values = Candidates(observation, COLUMNS).feature(name)[observation["action_mask"] > 0]
        assert (values >= np.array(feature.low) - 1e-5).all() and (values <= np.array(feature.high) + 1e-5).all()
        for unit, column in zip(feature.units, values.T):
            if unit in ("index", "clusters", "views", "0 or 1"):
                np.testing.assert_array_equal(column, np.round(column))
    values = Candidates(episode.observations[-1], COLUMNS).feature(name)[: len(episode.context.world_from_camera)]
    np.testing.assert_array_equal(evaluate_features((name,), episode.context), values)
    np.testing.assert_array_equal(evaluate_features(names[-1:], episode.context), values[:, -1:])


@pytest.mark.parametrize("column", COLUMNS)
def test_no_feature_knows_the_true_mesh(column: str, episode: Episode) -> None:
    before, after = (Candidates(o, COLUMNS)[column] for o in (episode.observations[-1], episode.swapped))
    np.testing.assert_array_equal(before, after)


def test_no_policy_is_told_of_the_true_mesh(episode: Episode) -> None:
    """A policy is a function of the observations, so that this holds for all of them."""
    assert episode.observations[-1].keys() == episode.swapped.keys()
    for key, value in episode.observations[-1].items():
        np.testing.assert_array_equal(value, episode.swapped[key], err_msg=key)


def test_the_swap_finds_a_feature_that_peeks(episode: Episode) -> None:
    @FEATURES.register("peeking_for_this_test")
    def peeking(context: FeatureContext) -> np.ndarray:
        scene = episode.env.reconstruction.scene
        return scene.raycaster.depth(context.camera, context.world_from_camera).mean(axis=(1, 2))

    try:
        with pytest.raises(AssertionError, match="a score asked the ground truth"):
            evaluate_features(("peeking_for_this_test",), episode.context)
    finally:
        del FEATURES._entries["peeking_for_this_test"]


# `activestructure` ends a settled episode by its own rule; `learned` scores this row like the others.
_WITH_OWN_RULE = ("activestructure", "learned")


@pytest.mark.parametrize("end", [0, 2])  # row that ends the episode
@pytest.mark.parametrize(
    "name", [*(name for name in POLICIES if not name.startswith(_WITH_OWN_RULE)), "aiisrfe?travel=shared"]
)
def test_the_row_that_ends_the_episode_is_not_taken_for_a_view(name: str, end: int) -> None:
    policy, rows = make_policy(name), (*CANDIDATE_COLUMNS, "from_pool", "from_finish", *STAGE_COLUMNS)
    columns = column_names(policy.required_features)
    policy.bind(columns)
    policy._rows = rows
    views = [row for row in range(3) if row != end]
    table = np.zeros((3, len(rows)), np.float32)
    place = {column: number for number, column in enumerate(rows)}
    # Two views that show nothing, 3 and 4 m away, and the row that ends the episode, at the agent's pose.
    table[views, place["x"]], table[:, place["look_x"]] = (3.0, 4.0), 1.0
    table[views, place["path_length"]], table[:, place["frames"]] = (3.0, 4.0), 500.0
    table[views, place["frames"]] = 30.0, 40.0
    table[views, place["from_pool"]] = table[end, place["from_finish"]] = 1.0
    features = np.zeros((3, len(columns)), np.float32)
    for column in ("voronoi_node", "aiisrfe_frontier", "activesplat_region", "rt_guide"):
        if column in columns:
            features[views, columns.index(column)] = -1.0
    observation = {
        "candidates": table,
        "candidate_features": features,
        "action_mask": np.ones(3, np.int8),
        "pose": np.array([0, 0, 0, 0.5, -0.5, 0.5, -0.5], np.float32),  # looks along +x
        "fidelity": np.array([20.0, 25.0], np.float32),
    }
    for _ in range(3):
        assert policy.act(observation) in views
    observation["action_mask"][views] = 0
    assert policy.act(observation) == end
