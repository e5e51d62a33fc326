"""What policies bring in the native setup: usable by every registered one, and nothing in the shared setup."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from activestructure_gym.config import configure
from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive.conditions import Conditions
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.running.actors import build
from activestructure_gym.ground_truth import ground_truth_of
from activestructure_gym.motion import planar_graph
from activestructure_gym.policies import POLICIES, NativeSettings, Policy, make_env_and_policy, make_policy
from activestructure_gym.policies.native_settings import native_settings_of
from activestructure_gym.scenes import load_scene

SMALL = {"sensor": {"width": 48, "height": 27}, "mapper.iterations": 1}


@pytest.mark.parametrize(
    "name", [name for name in POLICIES if native_settings_of(POLICIES.get(name), "native") != NativeSettings()]
)
def test_what_a_policy_brings_is_a_configuration_that_it_can_play(name: str) -> None:
    brought = POLICIES.get(name).native_settings
    config = configure("full", brought.overrides())
    assert brought.mapper in (None, config.mapper.name) and config.frame_budget == 2000
    assert config.mapper.iterations == (brought.iterations or configure("full").mapper.iterations)
    env, policy = make_env_and_policy(name, "box", setup="native", preset="fast", frame_budget=30, config=SMALL)
    stages = env.unwrapped.config.views.stages  # type: ignore[attr-defined]
    assert stages == (brought.stages or (("pool",),))
    policy.reset(0)
    observation, info = env.reset(seed=0)
    start, moved = observation["pose"].copy(), 0.0
    for _ in range(60):
        observation, _, terminated, truncated, info = env.step(policy.act(observation))
        moved = max(moved, float(np.abs(observation["pose"] - start).max()))
        assert not info["invalid_action"]
        if terminated or truncated:
            break
    assert info["frames"] > 1 and moved > 0.1
    env.close()


def begin(
    name: str, scene: str = "room", frame_budget: int = 60, **changes: Any
) -> tuple[Any, Policy, dict[str, np.ndarray]]:
    env, policy = make_env_and_policy(
        name, scene, setup="native", preset="fast", frame_budget=frame_budget, config={**SMALL, **changes}
    )
    policy.reset(0)
    return env.unwrapped, policy, env.reset(seed=0)[0]


@pytest.mark.parametrize("name", ["popgs_logdet", "next_best_sense", "gavis", "fisherrf", "view_angle"])
def test_selectors_of_views_map_what_they_pick_and_nothing_on_the_way(name: str) -> None:
    env, policy, observation = begin(name)
    keyframes, before, longest, ended = 1, 1, 0, False
    while not ended:
        observation, _, terminated, ended, info = env.step(policy.act(observation))
        assert info["keyframes"] == (keyframes := keyframes + 1)
        before, longest = info["frames"], max(longest, info["frames"] - before)
        ended |= terminated
    assert longest > 5  # a keyframe every 5 frames would be more


def test_rules_as_published_bring_their_schedule_and_hybrids_of_ours_bring_none() -> None:
    for name in POLICIES:
        if name.startswith(("popgs_", "next_best_sense", "fisherrf")) and name != "fisherrf_path":
            brought = native_settings_of(POLICIES.get(name), "native")
            assert (brought.overrides() == {}) == name.endswith("_cov"), name
            assert brought.iterations == (None if name.endswith("_cov") else 100)
            assert ("views.max_revisits" in brought.overrides()) != name.endswith("_cov")  # a view is selected once


def test_who_builds_on_splatam_maps_by_its_recipe_with_as_many_iterations_as_its_paper() -> None:
    ladder = ["activestructure", *(f"activestructure-{rung}" for rung in "abcd")]
    found = {name: configure("full", POLICIES.get(name).native_settings.overrides()).mapper for name in POLICIES}
    built = {name: mapper.iterations for name, mapper in found.items() if mapper.name == "splatam"}
    systems = ["activegamer", "gs_planner", "hgs_planner", *ladder]
    assert built == dict.fromkeys(systems, configure("default", {"mapper.name": "splatam"}).mapper.iterations) | {
        "fisherrf_path": 24,
        "activesplat": 2,
    }


def test_fisherrf_path_maps_every_4th_frame_with_60_iterations_every_10_frames() -> None:
    config = configure("full", POLICIES.get("fisherrf_path").native_settings.overrides())
    assert config.mapper.iterations / config.keyframe_every == 60 / 10 and config.keyframe_every == 4
    mapper, sensor = config.mapper, config.sensor
    assert (mapper.isotropic, mapper.mean_rate, mapper.log_scale_rate) == (False, 1e-3, 1e-2)
    # Ellipsoids begin as balls, and no step goes to keyframes that do not overlap with the new one.
    assert (mapper.seed_thickness, mapper.border_sigmas, mapper.in_front_factor) == (1.0, None, 10.0)
    assert (mapper.global_psnr, mapper.global_new_share) == (0.0, 1.0)
    assert (mapper.prune_opacity, mapper.prune_steps) == (1e-4, (0,)) and mapper.prune_scale > 1e6
    assert sensor.width == sensor.height and sensor.horizontal_fov_deg == 90.0


def test_activesplat_maps_by_its_own_configuration_of_splatam() -> None:
    mapper = configure("full", POLICIES.get("activesplat").native_settings.overrides()).mapper
    # Ellipsoids begin as balls, and no step goes to keyframes that do not overlap with the new one.
    assert (mapper.isotropic, mapper.seed_thickness, mapper.border_sigmas) == (False, 1.0, None)
    assert (mapper.global_psnr, mapper.global_new_share, mapper.window) == (0.0, 1.0, 12)
    assert mapper.overlap_border * 256 == 20.0


def test_fisherrf_path_is_offered_views_of_the_frontier_and_level_ones_at_one_height() -> None:
    env, policy, observation = begin("fisherrf_path")
    height = observation["pose"][2]
    for _ in range(3):
        candidates = policy.candidates(observation)
        facing, level = (candidates.source(name) for name in env.config.views.stages[0])
        np.testing.assert_array_equal(facing | level, candidates.valid)
        assert facing.any() and level.any()
        np.testing.assert_allclose(candidates.xyz[candidates.valid, 2], height, atol=1e-6)
        assert np.abs(candidates.view_direction[level, 2]).max() < 1e-6
        observation, *_ = env.step(policy.act(observation))
    env.close()


def test_view_angle_maps_200_iterations_after_each_view() -> None:
    brought = POLICIES.get("view_angle").native_settings
    assert brought.goal_keyframes and brought.iterations == 200


def test_depth_ends_where_the_original_discards_it() -> None:
    expected = {
        "activesplat": 10.0,
        "aiisrfe": 6.0,
        "anm_s": 10.0,
        "activeinr": 8.0,
        "gs_planner": 3.0,
        "hgs_planner": 5.0,
    }
    built = {name: configure("full", POLICIES.get(name).native_settings.overrides()) for name in expected}
    assert {name: config.sensor.max_range for name, config in built.items()} == expected
    # Voxels are observed as far as the original integrates depth.
    assert [built[name].volume.max_range for name in ("aiisrfe", "gs_planner")] == [6.0, 3.0]


def test_view_selectors_score_views_at_the_size_of_the_images() -> None:
    names = ("fisherrf", "gauss_mi", "gavis", "next_best_sense", "popgs_logdet", "view_angle", "fisherrf_path")
    scales = [configure("full", POLICIES.get(name).native_settings.overrides()).views.scoring_scale for name in names]
    assert scales == [1.0] * 6 + [0.5]  # the last one has a Gaussian per pixel


def test_what_is_brought_is_told_with_what_the_paper_spends() -> None:
    assert (
        NativeSettings().describe() == "nothing"
        and NativeSettings(budget="a day").describe() == "nothing; budget in its paper: a day"
    )
    assert NativeSettings(clearance_m=0.0, iterations=0).describe() == (
        "views 0.0 m from what is not free, 0 iterations a keyframe"
    )
    full = NativeSettings(
        "splatam", (("pool", "stay"), ("turns",)), 9, 4, False, 3, 0.5, {"sensor.width": 64}, "an hour"
    )
    assert full.describe() == (
        "views of pool + stay or turns, up to 9 of them, views 0.5 m from what is not free, mapper splatam, "
        "3 iterations a keyframe, a keyframe every 4 frames, sensor.width = 64; budget in its paper: an hour"
    )
    assert NativeSettings(goal_keyframes=True).describe() == "a keyframe at the end of a path"


def test_r3_recon_is_offered_views_of_the_frontier_and_around_the_agent() -> None:
    env, policy, observation = begin("r3_recon")
    observation, *_ = env.step(policy.act(observation))
    candidates = policy.candidates(observation)
    facing, around = candidates.source("frontier_facing?rows=30"), candidates.source("around?rows=70")
    assert 0 < facing.sum() <= 30 and 0 < around.sum() <= 70 and len(candidates) == 100
    np.testing.assert_array_equal(facing | around, candidates.valid)
    assert np.linalg.norm(candidates.xyz[around] - observation["pose"][:3], axis=1).max() <= 0.5 + 1e-5


@pytest.mark.parametrize("name", ["activeinr", "anm_s", "rt_guide"])
def test_planners_of_driving_robots_are_offered_level_views_at_one_height(name: str) -> None:
    env, policy, observation = begin(name)
    height = observation["pose"][2]
    for _ in range(3):
        candidates = policy.candidates(observation)
        assert np.abs(candidates.view_direction[candidates.valid, 2]).max() < 1e-6
        np.testing.assert_allclose(candidates.xyz[candidates.valid, 2], height, atol=1e-6)
        observation, *_ = env.step(policy.act(observation))


def test_anm_s_goes_to_the_nodes_themselves() -> None:
    env, policy, observation = begin("anm_s", frame_budget=200)
    stages = []
    for _ in range(8):
        candidates, row = policy.candidates(observation), policy.act(observation)
        if policy.trace()["node"] >= 0 and candidates.source("nodes?rows=504")[row]:
            nodes = planar_graph(env.reconstruction.volume, env.reconstruction.trajectory[0][:3, 3]).nodes
            stages.append(float(np.linalg.norm(nodes - candidates.xyz[row, :2], axis=1).min()))
        observation, *_ = env.step(row)
    assert len(stages) > 1 and max(stages) < 1e-5


def test_aiisrfe_is_offered_views_for_its_tasks_alone() -> None:
    env, policy, observation = begin("aiisrfe")
    observation, *_ = env.step(policy.act(observation))
    frontiers, unsure = (s for s in type(policy).native_settings.stages[0])
    candidates = policy.candidates(observation)
    np.testing.assert_array_equal(candidates.source(frontiers) | candidates.source(unsure), candidates.valid)
    assert candidates.source(frontiers).any()


def test_a_schedule_says_what_it_changes_and_nothing_else() -> None:
    assert NativeSettings().overrides() == {}
    full = NativeSettings(
        mapper="splatam",
        stages=(("turns",),),
        candidates=9,
        iterations=3,
        clearance_m=0.5,
        changes={"sensor.width": 64},
    )
    assert full.overrides() == {
        "mapper.name": "splatam", "views.stages": (("turns",),), "views.max_candidates": 9, "mapper.iterations": 3,
        "motion.candidate_clearance": 0.5, "sensor.width": 64,
    }  # fmt: skip
    config = configure("fast", NativeSettings(goal_keyframes=True).overrides())
    assert config.keyframe_every > config.frame_budget


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"keyframe_every": 5}, "goal_keyframes or keyframe_every, not both"),
        ({"stages": (("pool",), ("stay?rounds=3",))}, "a round of 'stay.rounds=3' costs the frames between two"),
    ],
)
def test_keyframes_at_goals_alone_leave_no_number_of_frames_between_them(given: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        NativeSettings(goal_keyframes=True, **given)


class Bringer(Policy):
    """Turns on its place."""

    native_settings = NativeSettings(stages=(("turns?count=5",),), goal_keyframes=True)

    def act(self, observation):
        return int(np.flatnonzero(observation["action_mask"])[1])


def test_a_job_in_the_native_setup_has_another_hash_and_the_policys_configuration() -> None:
    spec = "tests.policies.test_native_settings:Bringer"
    shared = Job("box", spec, 0, conditions=Conditions(preset="fast", frame_budget=20))
    native = Job("box", spec, 0, conditions=Conditions(preset="fast", frame_budget=20, setup="native"))
    assert "terms" not in shared.as_dict() and shared.hash != native.hash
    assert Job.from_dict(native.as_dict()) == native and Job.from_dict(shared.as_dict()) == shared
    known = ground_truth_of(load_scene("box"))
    assert build(shared, known)[1].config.views.stages == (("pool",),)
    policy, env = build(native, known)
    assert env.config.views.stages == (("turns?count=5",),)
    changed = Job(
        "box", spec, 0, conditions=Conditions(preset="fast", overrides=(("keyframe_every", 7),), setup="native")
    )
    assert build(changed, known)[1].config.keyframe_every == 7  # what was asked for goes before
    observation, _ = env.reset(seed=0)
    *_, info = env.step(policy.act(observation))
    # 72 degrees are 8 frames, of which the last alone is a keyframe.
    assert (info["frames"], info["keyframes"]) == (9, 2) and env.action_masks().sum() == 5


def test_wrong_terms_and_declarations_are_said() -> None:
    with pytest.raises(InputError, match="did you mean 'native'"):
        Job("box", "random", 0, conditions=Conditions(setup="nativ"))  # type: ignore[arg-type]
    with pytest.raises(InputError, match="native_settings of Odd must be a NativeSettings"):
        native_settings_of(type("Odd", (), {"native_settings": {"mapper": "splatam"}}), "native")
    with pytest.raises(InputError, match="give config as a dictionary"):
        make_env_and_policy(Bringer, "box", setup="native", config=configure("fast"))


def test_chance_has_the_views_of_a_planner_and_nothing_else_of_it() -> None:
    floor = make_policy("random?views_of=anm_s")
    assert native_settings_of(floor, "native") == POLICIES.get("anm_s").native_settings
    assert floor.required_features == make_policy("random").required_features == ()
    assert native_settings_of(make_policy("random"), "native") == NativeSettings()
    assert native_settings_of(floor, "shared") == NativeSettings()
    env, policy, observation = begin("random?views_of=anm_s")
    assert env.config.views.stages == POLICIES.get("anm_s").native_settings.stages
    assert observation["action_mask"][policy.act(observation)]
    env.close()
    with pytest.raises(InputError, match="unknown policy 'anms'; did you mean 'anm_s'"):
        make_policy("random?views_of=anms")
    assert make_policy(f"random?views_of={__name__}:Bringer").native_settings == Bringer.native_settings


def test_settings_of_another_name_are_refused_in_changes() -> None:
    for name, words in (("frame_budget", "all planners have the same"), ("features", "required_features"),
                        ("mapper.iterations", "a field of NativeSettings")):  # fmt: skip
        with pytest.raises(InputError, match=f"cannot set {name}: .*{words}"):
            NativeSettings(changes={name: 7})
