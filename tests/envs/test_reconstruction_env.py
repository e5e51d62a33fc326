"""What the shell promises beyond Gymnasium's contract."""

from __future__ import annotations

import re
import zlib
from typing import Any
from urllib.request import urlopen

import gymnasium as gym
import numpy as np
import pytest

from activestructure_gym.config import configure
from activestructure_gym.envs import ReconstructionEnv, panel
from activestructure_gym.envs.observation import observation_keys, observation_table
from activestructure_gym.errors import InputError, InputWarning
from activestructure_gym.features import FEATURES
from activestructure_gym.scenes import load_scene
from activestructure_gym.volume import FREE, OCCUPIED, VolumeConfig, VoxelVolume


@pytest.fixture
def env(box_options: dict[str, Any]) -> ReconstructionEnv:
    return ReconstructionEnv(**box_options)


def step_until_end(env: ReconstructionEnv, info: dict[str, Any]) -> list[tuple[float, bool, bool, dict[str, Any]]]:
    steps = []
    for _ in range(1000):
        _, reward, terminated, truncated, info = env.step(int(np.flatnonzero(info["action_mask"])[0]))
        steps.append((reward, terminated, truncated, info))
        if terminated or truncated:
            return steps
    raise AssertionError("the episode never ended")


def test_budget_truncates_exactly_there(env: ReconstructionEnv) -> None:
    _, info = env.reset(seed=0)
    steps = step_until_end(env, info)
    assert steps[-1][1:3] == (False, True)
    assert steps[-1][3]["frames"] == 40
    assert [s[3]["frames"] for s in steps] == sorted(s[3]["frames"] for s in steps)
    with pytest.raises(gym.error.ResetNeeded):
        env.step(0)


def test_a_masked_action_costs_a_frame_and_moves_nothing(env: ReconstructionEnv) -> None:
    env.reset(seed=0)
    table = env.reconstruction.candidates
    env.reconstruction.candidates = type(table)(
        table.ids[:3], table.world_from_camera[:3], table.path_length[:3], table.revisit[:3]
    )
    _, reward, terminated, truncated, info = env.step(3)
    assert info["invalid_action"] is True
    assert (info["frames"], info["metres"], info["keyframes"]) == (2, 0.0, 1)
    assert reward == pytest.approx(-0.05)
    assert not terminated and not truncated


@pytest.mark.parametrize("action", [-1, 24, 1.5, "0"])
def test_an_action_outside_the_space_is_an_error(env: ReconstructionEnv, action: Any) -> None:
    env.reset(seed=0)
    with pytest.raises(gym.error.InvalidAction, match=r"expected an integer in \[0, 24\)"):
        env.step(action)


def test_reward_is_the_sum_of_its_terms_and_coverage_adds_up(env: ReconstructionEnv) -> None:
    _, info = env.reset(seed=0)
    first = env._coverage.share
    steps = step_until_end(env, info)
    for reward, _, _, step_info in steps:
        assert isinstance(reward, float)
        assert reward == pytest.approx(sum(v for k, v in step_info.items() if k.startswith("reward/")))
    gained = sum(s[3]["reward/coverage"] for s in steps) / 20.0
    assert gained == pytest.approx(env._coverage.share - first)
    assert gained > 0.1
    walked = -sum(s[3]["reward/path"] for s in steps) / 0.01
    assert walked == pytest.approx(steps[-1][3]["metres"])


def test_reaching_the_coverage_target_terminates(box_options: dict[str, Any]) -> None:
    env = ReconstructionEnv(**{**box_options, "coverage_target": 0.4, "frame_budget": 300})
    _, info = env.reset(seed=0)
    steps = step_until_end(env, info)
    assert steps[-1][1] is True and steps[-1][3]["is_success"] is True
    assert not any(s[3]["is_success"] for s in steps[:-1])


def test_without_a_target_no_ground_truth_ends_the_episode(box_options: dict[str, Any]) -> None:
    env = ReconstructionEnv(**{**box_options, "coverage_target": None})
    _, info = env.reset(seed=0)
    env._coverage.seen[:] = True
    steps = step_until_end(env, info)
    assert steps[-1][1:3] == (False, True)
    assert not any(s[3]["is_success"] for s in steps)


def test_rendering(box_options: dict[str, Any]) -> None:
    env = ReconstructionEnv(**box_options, render_mode="rgb_array")
    with pytest.raises(gym.error.ResetNeeded):
        env.render()
    env.reset(seed=0)
    before = env.render()
    env.step(0)
    after = env.render()
    assert before.dtype == np.uint8 and before.ndim == 3 and before.shape == after.shape
    assert (before != after).any()
    with pytest.raises(InputError, match="render_mode must be one of"):
        ReconstructionEnv(**box_options, render_mode="ansi")


def test_human_rendering_serves_a_page_until_the_env_is_closed(
    box_options: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    plain, env = ReconstructionEnv(**box_options), ReconstructionEnv(**box_options, render_mode="human")
    for seed in (0, 1):
        expected, _ = plain.reset(seed=seed)
        observation, _ = env.reset(seed=seed)
        assert all(np.array_equal(expected[name], observation[name]) for name in expected)
    expected, observation = plain.step(1)[0], env.step(1)[0]
    assert all(np.array_equal(expected[name], observation[name]) for name in expected)
    assert env.render() is None
    (link,) = re.findall(r"watch this environment at (http://127\.0\.0\.1:\d+/\?key=\S+)", capsys.readouterr().err)
    with urlopen(link.replace("/?", "/news?episode=-1&moments=0&version=-1&"), timeout=20) as answer:
        assert b'"episode": 2' in zlib.decompress(answer.read())
    env.close()
    env.close()
    with pytest.raises(OSError):
        urlopen(link, timeout=5)
    with pytest.raises(gym.error.ClosedEnvironmentError):  # and no second page
        env.reset(seed=0)
    assert capsys.readouterr().err == ""


def test_options_of_one_episode_do_not_stick(env: ReconstructionEnv) -> None:
    env.reset(seed=0)
    usual = env.reconstruction.pose
    env.reset(seed=0, options={"start_pose": (2.0, 1.5, 1.2, 90.0)})
    np.testing.assert_allclose(env.reconstruction.pose[:3, 3], (2.0, 1.5, 1.2))
    np.testing.assert_allclose(env.reconstruction.pose[:3, 2], (0.0, 1.0, 0.0), atol=1e-12)
    env.reset(seed=0, options={})
    np.testing.assert_array_equal(env.reconstruction.pose, usual)
    with pytest.raises(InputError, match="unknown reset option 'secne'"):
        env.reset(options={"secne": "box"})


def test_of_several_scenes_one_is_drawn_per_episode(box_options: dict[str, Any]) -> None:
    env = ReconstructionEnv(**{**box_options, "scene": ["box?seed=0", "box?seed=1", "box?seed=2"]})
    env.reset(seed=0)
    names = set()
    for _ in range(12):
        env.reset()
        names.add(env.reconstruction.scene.content_hash)
    assert len(names) == 3


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"frame_budget": 0}, "the frame budget must be at least 1, got 0"),
        ({"preset": "fsat"}, "unknown preset 'fsat'; did you mean 'fast'"),
        ({"config": {"sensor.widht": 3}}, "unknown field 'widht' of SensorConfig; did you mean 'width'"),
        ({"features": ("pixle",)}, "unknown feature 'pixle'; did you mean 'pixel'"),
        ({"reward": {"coverag": 1.0}}, "unknown field 'coverag' of RewardConfig"),
        ({"coverage_target": 0.0}, "coverage_target is a share"),
        ({"scene": []}, "at least one scene"),
        ({"start_pose": (1.0, 2.0)}, "a start pose is"),
        ({"start_pose": (1.0, 2.0, float("nan"), 0.0)}, "finite"),
        ({"start_pose": "door"}, "a start pose is"),
        ({"features": "pixel"}, "features must be a list of names, got 'pixel'"),
        ({"scene": 3}, "scene must be a name, a path"),
        ({"observation_keys": ["depth", "plane_mas"]}, "unknown entry 'plane_mas' of the observation.*plane_mask"),
        ({"observation_keys": "depth"}, "observation_keys must be a list of one or more names, got 'depth'"),
        ({"observation_keys": []}, "observation_keys must be a list of one or more names"),
        ({"max_planes": 1.5}, "max_planes must be a whole number"),
        ({"coverage_target": "all"}, "coverage_target is a share"),
        ({"config": {"views.heights_m": ()}}, "heights_m must be a tuple"),
        ({"preset": 3}, "preset must be a name, got 3"),
        ({"preset": None}, "preset must be a name, got None"),
        ({"frame_budget": 10**400}, "the frame budget must be at most 1000000, got 1000"),
        ({"frame_budget": 10**5000}, "the frame budget must be at most 1000000, got something of the kind int"),
        ({"frame_budget": float("nan")}, "frame_budget must be a whole number, got nan"),
        ({"frame_budget": True}, "frame_budget must be a whole number, got True"),
        ({"features": [1]}, "a feature is given by its name, as a text, got 1"),
        ({"features": [["pixel"]]}, "a feature is given by its name"),
        ({"features": [b"pixel"]}, "a feature is given by its name"),
        ({"features": ["pi\nxel"]}, "unknown feature 'pi\\\\nxel'"),
        ({"features": ["os:sep"]}, "feature 'os:sep' must be a function of a FeatureContext, got '/'"),
        ({"features": 7}, "features must be a list of names, got 7"),
        ({"features": {"pixel"}}, "features must be a list of names"),
        ({"config": [("a", 1)]}, "config must be a dictionary with names as keys"),
        ({"config": {1: 2}}, "config must be a dictionary with names as keys"),
        ({"reward": "x"}, "reward must be a dictionary with names as keys, got 'x'"),
        ({"max_planes": True}, "max_planes must be a whole number of at least 1, got True"),
        ({"max_planes": 10**6}, "one observation would take more than 128 MiB .* max_planes 1000000"),
        ({"max_planes": 10**400}, "one observation would take more than 128 MiB"),
        ({"config": {"views.max_candidates": 2**63 - 1}}, "max_candidates must be .* 65536, got 9223372036854775807"),
        ({"config": {"views.max_candidates": 10**5000}}, "max_candidates must be .* 65536, got something"),
        ({"coverage_target": True}, "coverage_target is a share"),
        ({"coverage_target": 10**5000}, "coverage_target is a share"),
        ({"start_pose": [10**400] * 4}, "a start pose is"),
        ({"start_pose": np.full((4, 4), np.nan)}, "finite"),
        ({"start_pose": np.diag([1.0, 1.0, 1.0, 1.0])[[2, 1, 0, 3]]}, "a start pose must be without roll"),
        ({"scene": ["box", 3]}, "scene must be a name, a path"),
        ({"scene": b"box"}, "scene must be a name, a path"),
    ],
)
def test_bad_input_gets_one_clear_sentence(box_options: dict[str, Any], changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message.replace("(", r"\(")) as caught:
        ReconstructionEnv(**{**box_options, **changes})
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "reward",
    [{"coverage": float("nan")}, {"path": "far"}, {"coverage": 10**400}, {"path": 1e308}, {"tolerance_m": -0.1}],
)
def test_a_reward_that_is_no_number_is_refused(box_options: dict[str, Any], reward: dict[str, Any]) -> None:
    with pytest.raises(InputError):
        ReconstructionEnv(**box_options, reward=reward)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (3, "must be a dictionary"),
        ({"scene": None}, "scene must be a name, a path or a Scene, got None"),
        ({"scene": 3}, "scene must be a name"),
        ({"scene": ["box"]}, "scene must be a name"),
        ({"scene": "world:simulated"}, "takes no world"),
        ({1: 2}, "names as keys"),
        ({"start_pose": None}, "pose"),
    ],
)
def test_reset_options_that_cannot_be_used(box_options: dict[str, Any], options: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        ReconstructionEnv(**box_options).reset(seed=0, options=options)


def test_after_a_reset_that_was_refused_no_earlier_episode_goes_on(env: ReconstructionEnv) -> None:
    env.reset(seed=0)
    with pytest.raises(InputError):
        env.reset(seed=1, options={"start_pose": (99.0, 0.0, 1.2, 0.0)})
    for act in (lambda: env.step(0), env.action_masks, env.observation):
        with pytest.raises(gym.error.ResetNeeded):
            act()


def test_a_preset_beside_a_whole_configuration_is_refused() -> None:
    with pytest.raises(InputError, match="leave out preset, got 'rl'"):
        ReconstructionEnv("box", preset="rl", config=configure("fast"))


def test_an_unknown_reward_is_told_with_the_known_ones(box_options: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=r"unknown field 'cov' of RewardConfig\. Nearest of \d+: .*coverage"):
        ReconstructionEnv(**box_options, reward={"cov": 1})


def test_heights_outside_the_scene_are_refused_at_reset(box_options: dict[str, Any]) -> None:
    config = {**box_options["config"], "views": {"max_candidates": 24, "heights_m": (5.0, -5.0)}}
    env = ReconstructionEnv(**{**box_options, "config": config})
    with pytest.raises(InputError, match="no height of views.heights_m"):
        env.reset(seed=0)


def test_masks_before_reset_say_so(env: ReconstructionEnv) -> None:
    with pytest.raises(gym.error.ResetNeeded):
        env.action_masks()


def test_plan_tells_walls_from_what_the_camera_may_pass_over() -> None:
    volume = VoxelVolume(np.array([[0.0, 0, 0], [1, 1, 2]]), VolumeConfig())
    column = {(2, 2): (FREE, FREE), (4, 4): (OCCUPIED, OCCUPIED), (6, 6): (OCCUPIED, FREE)}
    middle = int(volume.voxel_of(np.array([[0.5, 0.5, 1.0]]))[0, 2])
    for (x, y), (below, above) in column.items():
        volume.state[x, y, middle - 2 : middle], volume.state[x, y, middle : middle + 3] = below, above
    image = panel.plan_image(volume, 1.0)
    colours = (panel.FREE_COLOUR, panel.OCCUPIED_COLOUR, panel.PARTLY_COLOUR)
    for (x, y), colour in zip(column, colours):
        np.testing.assert_array_equal(image[x, y], colour)
    np.testing.assert_array_equal(image[8, 2], panel.UNKNOWN_COLOUR)


def test_a_start_inside_a_wall_is_refused(box_options: dict[str, Any]) -> None:
    env = ReconstructionEnv(**box_options, start_pose=(0.0, 1.0, 1.2, 0.0))
    with pytest.raises(InputError):
        env.reset(seed=0)


def test_the_seed_of_the_layout_reaches_every_scene_that_takes_one(box_options: dict[str, Any]) -> None:
    small = {key: value for key, value in box_options.items() if key != "scene"}
    room = "activestructure_gym:ActiveStructure/Room-v0"
    for given, meant in ((("box", 4), "box?seed=4"), (("box?size=5,4,3", 4), "box?size=5,4,3&seed=4")):
        env = gym.make(room, scene=given[0], scene_seed=given[1], **small).unwrapped
        env.reset(seed=0)
        assert env.reconstruction.scene.content_hash == load_scene(meant).content_hash
    assert load_scene("box?seed=4").content_hash != load_scene("box").content_hash
    several = gym.make(room, scene=["box", "box?size=5,4,3"], scene_seed=4, **small).unwrapped
    assert several._scenes == ["box?seed=4", "box?size=5,4,3&seed=4"]
    assert gym.make(room, scene_seed=3).unwrapped._scenes == ["room?seed=3"]
    flat = gym.make("activestructure_gym:ActiveStructure/Apartment-v0", scene_seed=3, rooms=2)
    assert flat.unwrapped._scenes == ["apartment?rooms=2&seed=3"]


@pytest.mark.parametrize(
    ("task", "given", "message"),
    [
        ("Room", {"scene": "box?seed=3", "scene_seed": 4}, "the scene 'box?seed=3' gives its own seed; give it in one"),
        (
            "Room",
            {"scene": load_scene("box"), "scene_seed": 4},
            "is loaded already, so its options cannot be changed: remove seed",
        ),
        ("Apartment", {"scene": "box", "rooms": 2}, "the scene 'box' has no option 'rooms'; remove this option"),
        ("Room", {"scene_seed": 1.5}, "scene_seed must be a whole number from 0 to 2^63 - 1, got 1.5"),
        ("Room", {"scene_seed": -1}, "scene_seed must be a whole number"),
        ("Room", {"scene_seed": 10**5000}, "scene_seed must be a whole number"),
        ("Room", {"scene_seed": True}, "scene_seed must be a whole number"),
        ("Apartment", {"rooms": "two"}, "rooms must be a whole number"),
    ],
)
def test_a_number_that_the_scene_cannot_use_is_refused(task: str, given: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as caught:
        gym.make(f"activestructure_gym:ActiveStructure/{task}-v0", **given)
    assert message in str(caught.value)


def test_tasks_that_need_a_scene_say_so() -> None:
    for task in ("Mesh", "Replica", "Matterport3D"):
        with pytest.raises(InputError, match=f"{task}-v0 needs a scene, for example gymnasium.make"):
            gym.make(f"activestructure_gym:ActiveStructure/{task}-v0")


def test_ground_truth_stays_behind(box_options: dict[str, Any]) -> None:
    """With the true mesh swapped after the frames are recorded, observation and features stay the same."""
    env = ReconstructionEnv(**{**box_options, "features": tuple(FEATURES)})
    env.reset(seed=0)
    before = env.observation()
    env.reconstruction.scene = load_scene("box?seed=3")
    env.reconstruction._refresh()
    after = env.observation()
    for name in before:
        np.testing.assert_array_equal(before[name], after[name])


def test_table_of_the_observation_names_every_key(env: ReconstructionEnv) -> None:
    observation, _ = env.reset(seed=0)
    keys = observation_keys(env.config, env.max_planes)
    assert set(keys) == set(observation) == set(env.observation_space.keys())
    table = observation_table(env.config, env.max_planes)
    assert all(f"`{name}`" in table for name in keys)


@pytest.mark.parametrize("y", [0.30, 0.33])
def test_an_accepted_start_in_a_narrow_place_has_views(box_options: dict[str, Any], y: float) -> None:
    env = ReconstructionEnv(**box_options, start_pose=(2.0, y, 1.25, 90.0))
    observation, _ = env.reset(seed=0)
    assert observation["action_mask"].any()
    before = env.reconstruction.frames
    _, _, _, _, info = env.step(int(np.flatnonzero(observation["action_mask"])[0]))
    assert not info["invalid_action"] and info["frames"] > before


def test_who_is_offered_nothing_at_the_start_is_told(box_options: dict[str, Any]) -> None:
    stages = (("frontier_facing?rows=4&nearest_m=98&farthest_m=99",),)
    env = ReconstructionEnv(**{**box_options, "config": {"views": {"stages": stages}}})
    with pytest.warns(InputWarning, match="no candidate view at the start: none of the views that 'frontier_facing"):
        observation, _ = env.reset(seed=0)
    assert not observation["action_mask"].any()


def test_a_budget_of_one_image_is_never_overdrawn(box_options: dict[str, Any]) -> None:
    env = ReconstructionEnv(**{**box_options, "frame_budget": 1})
    env.reset(seed=0)
    *_, truncated, info = env.step(env.action_space.n - 1)
    assert truncated and info["frames"] == 1


def test_without_map_and_planes_the_same_actions_lead_to_the_same_views_and_rewards() -> None:
    """Preset `rl` is `fast` without what is read from Gaussians and planes."""
    envs = [ReconstructionEnv("box", preset=preset, frame_budget=60) for preset in ("fast", "rl")]  # type: ignore[arg-type]
    empty = ("plane_features", "plane_mask", "plane_edges", "plane_tree", "candidate_planes", "fidelity")
    equal = ("rgb", "depth", "pose", "budget", "candidates", "action_mask")
    (full, _), (less, info) = (env.reset(seed=3) for env in envs)
    done, rng = False, np.random.default_rng(0)
    while not done:
        assert all(np.array_equal(full[key], less[key]) for key in equal)
        assert full["plane_mask"].any() and not any(less[key].any() for key in empty)
        assert (info["gaussians"], info["planes"]) == (0, 0)
        action = int(rng.choice(np.flatnonzero(info["action_mask"])))
        (full, *ends, _), (less, *others, info) = (env.step(action) for env in envs)
        assert ends == others
        done = ends[1] or ends[2]


@pytest.mark.parametrize(("preset", "rows"), [("default", 256), ("full", 256), ("fast", 64), ("rl", 64)])
def test_all_planes_of_a_house_are_observed_but_for_learning(preset: Any, rows: int) -> None:
    space = ReconstructionEnv("box", preset=preset).observation_space
    assert space["plane_mask"].shape == (rows,)
    assert space["candidate_planes"].shape[1] == rows


def test_chosen_entries_of_the_observation_are_as_in_the_whole_one(box_options: dict[str, Any]) -> None:
    chosen = ["action_mask", "depth", "candidate_features"]
    whole, less = ReconstructionEnv(**box_options), ReconstructionEnv(**box_options, observation_keys=chosen)
    (full, _), (part, _) = whole.reset(seed=1), less.reset(seed=1)
    assert set(part) == set(less.observation_space.spaces) == set(chosen) and part in less.observation_space
    assert all(np.array_equal(part[key], full[key]) for key in chosen)
    assert set(less.step(0)[0]) == set(chosen)
