"""The phases of ActiveStructure: their pools, their ends, and revisits."""

from __future__ import annotations

import json
import pickle
from dataclasses import replace

import numpy as np
import pytest

from activestructure_gym.envs import ReconstructionEnv
from activestructure_gym.envs.observation import CANDIDATE_COLUMNS
from activestructure_gym.evaluation.protocols import CameraPath
from activestructure_gym.evaluation.protocols.visibility import seen_by_keyframes
from activestructure_gym.ground_truth import GroundTruth, ground_truth_of
from activestructure_gym.policies import make_env_and_policy, make_policy
from activestructure_gym.policies.activestructure import (
    PHASES,
    ActiveStructure,
    PhaseMachine,
    information_gain,
)
from activestructure_gym.policies.activestructure.phases import (
    GOOD_PSNR,
    LOT,
    MIN_RISE_DB,
    RevisitedViews,
    in_pool,
)
from activestructure_gym.policies.base import patience
from activestructure_gym.scenes import load_scene
from tests.policies.activestructure.test_policy import observation, planes
from tests.policies.binding import bound

NOTHING = [[0.0, 0.0]] * 3
PATIENCE = patience(len(NOTHING) + 1)  # `observation` adds a masked row


def test_small_tables_take_more_decisions_until_as_many_views_were_offered() -> None:
    assert [patience(rows) for rows in (1027, 256, 255, 64, 3)] == [3, 3, 4, 12, 256]


def test_a_phase_ends_only_after_empty_pools_in_a_row() -> None:
    machine, empty, full = PhaseMachine(), np.zeros(4, bool), np.array([False, True, False, False])
    for _ in range(2 * PATIENCE):
        assert machine.update(full) is None
    for _ in range(20):  # an interrupted row begins again
        for _ in range(PATIENCE - 1):
            assert machine.update(empty) is None
        assert machine.update(full) is None
    assert machine.index == 0
    for expected in (1, 2):
        for _ in range(PATIENCE - 1):
            assert machine.update(empty) is None
            assert machine.index == expected - 1
        assert str(PATIENCE) in machine.update(empty)
        assert machine.index == expected
    for _ in range(2 * PATIENCE):
        assert machine.update(empty) is None
    assert machine.phase is PHASES[2]


def test_polarity_reverses_between_the_first_two_phases() -> None:
    first, second = PHASES[0].weights, PHASES[1].weights
    assert first.structural > 0 > second.structural
    assert second.objects > 0
    assert second.max_discount > first.max_discount
    # Two views of as many pixels: one of nothing, one of a poor wall, the only plane.
    wall = planes([[0], [1]], [0.1], [0.5], [1])
    scaffold, objects = (information_gain(np.full(2, 0.4), np.zeros(2), wall, w).total for w in (first, second))
    assert scaffold[1] > scaffold[0]
    assert objects[1] < objects[0]


def test_the_pool_holds_views_with_enough_pixels_or_deficit() -> None:
    first, second = PHASES[0], PHASES[1]
    nothing = planes(np.zeros((4, 1)), [0.5], [0.5], [1])
    pixel = np.array([first.pool_share + 0.001, first.pool_share - 0.001, 0.0, 0.9])
    terms = information_gain(np.full(4, 0.9), np.array([0.0, 0.0, 1.0, 0.0]), nothing, first.weights)
    valid, here = np.array([True, True, True, False]), np.ones(4)
    np.testing.assert_array_equal(in_pool(pixel, terms, here, valid, first), [True, False, False, False])
    np.testing.assert_array_equal(in_pool(pixel, terms, here, valid, second), [True, True, True, False])
    # What the discount, the suppression or the travel takes away counts too.
    lowered = replace(terms, discount=np.array([0.5, 0, 0, 0]))
    assert not in_pool(pixel, lowered, here, valid, first)[0]
    assert not in_pool(pixel, replace(terms, suppressed=np.array([0.5, 1, 1, 1])), here, valid, first)[0]
    assert not in_pool(pixel, terms, 0.9 * here, valid, first)[0]


def test_the_pool_counts_what_a_view_shows_itself_and_not_what_its_path_shows() -> None:
    policy = bound(ActiveStructure())
    assert policy.required_features == ("unknown_volume_way", "deficiency", "unknown_volume")
    near, far = 1.0, 20.0  # frames; g = 1 / (1 + frames / 5)
    for way, view, frames, phase in ((9.0, 0.0, near, 1), (0.5, 0.5, near, 0), (9.0, 0.3, far, 1), (9.0, 1.0, far, 0)):
        policy.reset(0)
        for _ in range(patience(2)):
            policy.act(observation([[way, 0.0, view]], frames=[frames]))
        assert policy._machine.index == phase, (way, view, frames)


def in_last_phase(*, revisits: bool) -> ActiveStructure:
    policy = bound(ActiveStructure(discovery="hole_area", revisits=revisits))
    policy.reset(0)
    for _ in range(2 * PATIENCE):
        policy.act(observation(NOTHING))
    return policy


def test_the_full_model_goes_through_its_phases_as_the_pools_run_empty() -> None:
    policy = bound(ActiveStructure(discovery="hole_area"))
    policy.reset(0)
    names = []
    rich, poor = [[0.5, 0.0]] * 3, [[0.06, 0.0]] * 3  # poor: enough for phase II, not for phase I
    for features in [rich] * 40 + [poor] * (PATIENCE + 40) + [NOTHING] * (PATIENCE + 5):
        policy.act(observation(features))
        names.append(policy.trace()["phase"])
    changes = [40 + PATIENCE - 1, 40 + PATIENCE + 40 + PATIENCE - 1]
    expected = [PHASES[sum(t >= change for change in changes)].name for t in range(len(names))]
    assert names == expected


def test_phase_three_revisits_each_keyframe_once_until_they_are_good() -> None:
    policy = in_last_phase(revisits=True)
    features, frames = [[0.3, 0.0], [0.6, 0.0], [0.0, 0.0]], [5.0, 5.0, 40.0]

    def chosen(place: float, fidelity: float = GOOD_PSNR - 0.1, masked: bool = False) -> tuple[int, str | None]:
        observed = observation(features, frames=frames, revisit=(2,), fidelity=fidelity)
        observed["candidates"][2, CANDIDATE_COLUMNS.index("x")] = place
        observed["action_mask"][2] = not masked
        return policy.act(observed), policy.trace()["settled"]

    none_left, good = "the worst keyframes have been revisited", "nine tenths of the keyframes reach 34 dB"
    assert chosen(1.0) == (2, None)
    assert chosen(1.0) == (1, none_left)  # it was there, and the keyframe is still the worst: nothing moves any more
    assert chosen(2.0, fidelity=GOOD_PSNR) == (1, good)
    assert chosen(2.0, masked=True) == (1, none_left)  # a row that is masked is no keyframe to go to
    assert chosen(2.0) == (2, None)
    policy.reset(0)
    for _ in range(2 * PATIENCE):
        policy.act(observation(NOTHING))
    assert chosen(1.0) == (2, None)


def test_without_revisits_phase_three_explores() -> None:
    policy = in_last_phase(revisits=False)
    assert policy.act(observation([[0.3, 0.0], [0.6, 0.0], [0.0, 0.0]], revisit=(2,), fidelity=20.0)) == 1
    assert policy.trace()["phase"] == PHASES[2].name and policy.trace()["settled"] == "no revisits (revisits=false)"


def test_revisits_end_for_good_when_some_in_a_row_mended_nothing() -> None:
    policy = in_last_phase(revisits=True)

    def revisits(fidelity: float, place: float) -> bool:
        observed = observation([[0.3, 0.0], [0.0, 0.0]], revisit=(1,), fidelity=fidelity)
        observed["candidates"][1, CANDIDATE_COLUMNS.index("x")] = place
        return policy.act(observed) == 1 and not policy.trace()["settled"]

    psnr, place = 25.0, 0.0
    for _ in range(3):  # each lot is as much better as it must be, however the single ones turn out
        for step in range(LOT):
            assert revisits(psnr - (0.5 if step else 0.0), place := place + 1.0)
        psnr += 1.01 * MIN_RISE_DB
    psnr -= 0.02 * MIN_RISE_DB
    assert not revisits(psnr, place + 1.0)
    assert not revisits(psnr - 10.0, place + 2.0)
    policy.reset(0)
    for _ in range(2 * PATIENCE):
        policy.act(observation(NOTHING))
    assert revisits(psnr, place + 1.0)


def test_a_keyframe_is_known_by_place_and_direction() -> None:
    sent, view = RevisitedViews(), np.array([1.0, 2.0, 1.5, 0.0, 1.0, 0.0])
    others = np.stack([view, view + 1e-4, view + [0.02, 0, 0, 0, 0, 0], view + [0, 0, 0, 0.02, 0, 0]])
    assert not sent.includes(others).any()
    sent.add(view)
    assert sent.includes(others).tolist() == [True, True, False, False]
    assert sent.includes(others[:0]).shape == (0,)


def test_reset_begins_again_with_the_first_phase_and_a_pickle_does_not() -> None:
    policy = in_last_phase(revisits=True)
    observed = observation([[0.9, 0.0], [0.1, 0.0]], revisit=(1,))
    copy = pickle.loads(pickle.dumps(policy))
    assert copy.act(observed) == policy.act(observed) == 1
    assert copy.trace() == policy.trace()
    policy.reset(1)
    assert policy.act(observed) == 0
    assert policy.trace()["phase"] == PHASES[0].name


def test_the_full_model_ends_where_that_is_offered_and_nothing_moves_any_more() -> None:
    env, policy = make_env_and_policy(
        "activestructure",
        "box",
        preset="fast",
        frame_budget=600,
        coverage_target=None,
        config={
            "sensor": {"width": 48, "height": 27},
            "views": {"stages": [["pool", "finish"]], "max_candidates": 256},
        },
    )
    for seed in range(8):  # a start may have no other free place; which one depends on the processor's rounding
        policy.reset(seed)
        observation, info = env.reset(seed=seed)
        phases, ended = [], False
        while not ended:
            row = policy.act(observation)
            ends = bool(policy.candidates(observation).source("finish")[row])
            alone = observation["action_mask"].sum() == 1
            settled = bool(policy.trace().get("settled"))
            phases.append(policy.trace()["phase"])
            assert ends == settled or alone  # not before, though it is the nearest row
            observation, _, terminated, truncated, info = env.step(row)
            ended = terminated or truncated
        if settled:
            break
    assert settled and terminated and ends and info["frames"] < 600
    assert set(phases) == {phase.name for phase in PHASES}


def test_the_trace_names_the_last_phase() -> None:
    late = in_last_phase(revisits=True)
    late.act(observation(NOTHING, revisit=(1,)))
    assert json.loads(json.dumps(late.trace())) == late.trace()
    assert late.trace()["phase"] == PHASES[2].name


def seen_when_the_scaffold_ends(truth: GroundTruth, seed: int) -> float:
    """Return the share of the surface that is observed when phase I ends, from the start pose of ``seed``."""
    policy = make_policy("activestructure")
    features = policy.required_features
    # With 0.5 m between lattice positions, none may be in a narrow passage, and the phase ends before it.
    env = ReconstructionEnv(
        scene=truth,
        preset="fast",
        frame_budget=4000,
        features=features,
        coverage_target=None,
        config={"views.lattice_step_m": 0.25},
    )
    policy.bind(env.config.features)
    policy.reset(0)
    observation, info = env.reset(seed=seed)
    while True:
        action = policy.act(observation)
        if policy.trace()["phase"] != PHASES[0].name:
            break
        observation, _, terminated, truncated, info = env.step(action)
        assert not (terminated or truncated), "phase I has not ended"
    keyframes = np.array([frame.world_from_camera for frame in env.reconstruction.mapper.keyframes])
    path = CameraPath(env.config.sensor.camera, keyframes[0], keyframes)
    points = truth.observable_surface.points[::20]
    env.close()
    return float(seen_by_keyframes(points, path, truth.scene, 2e-3).mean())


@pytest.mark.slow
@pytest.mark.parametrize("rooms, starts", [(1, (0,)), (3, (0, 4, 7)), (7, (0,))])
def test_the_scaffold_is_complete_when_its_phase_ends(rooms: int, starts: tuple[int, ...]) -> None:
    truth = ground_truth_of(load_scene(f"apartment?rooms={rooms}&seed=3&lit=false"))
    for seed in starts:
        assert 0.75 < seen_when_the_scaffold_ends(truth, seed) < 0.97
