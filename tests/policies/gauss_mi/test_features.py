"""GauSS-MI's gain against the sum over Gaussians, its revisits by hand, and what it is blind to."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from activestructure_gym import Reconstruction, configure, ground_truth_of, load_scene
from activestructure_gym.features import evaluate_features
from activestructure_gym.geometry import look_along
from activestructure_gym.policies.gauss_mi.features import (
    FEW,
    FORGETTING,
    gauss_mi,
    reliability,
    revisit_discount,
    seen_from,
)
from activestructure_gym.policies.gauss_mi.reliability import direction_shares
from activestructure_gym.splatting.fisher import view_information


def test_blended_numbers_are_shares_of_directions_times_surprise(rng) -> None:
    means, surprise = rng.normal(size=(3, 50)).astype(np.float32), rng.random((4, 50), dtype=np.float32)
    eye = np.array([0.1, -0.2, 0.3])
    expected = (direction_shares(means.T.astype(float), eye) * surprise.T).sum(axis=1)
    assert seen_from(eye, means, surprise) == pytest.approx(expected, rel=1e-4)


def test_against_the_sum_over_gaussians(two_walls, looks) -> None:
    context, gaussians = two_walls.context(*looks), two_walls.mapper.map
    surprise = -np.log(1.0 / (1.0 + np.exp(-reliability(context))))
    expected = []
    for pose in looks:
        (view,) = view_information(gaussians.parameters, gaussians.count, context.camera, pose)
        shares = direction_shares(gaussians.parameters[:3, view.indices].T.astype(float), pose[:3, 3])
        expected.append((view.weights[:, None] * shares * surprise[view.indices]).sum() / (16 * 12))
    assert gauss_mi(context) == pytest.approx(expected, rel=1e-4, abs=1e-6)
    assert evaluate_features(("gauss_mi",), context)[:, 0] == pytest.approx(expected, rel=1e-4, abs=1e-6)


def test_unreliable_is_what_was_seen_wrong_or_never_from_there(two_walls, looks, frame_of) -> None:
    east = look_along(np.zeros(3), np.array([1.0, 0.0, 0.0]))
    behind = look_along(np.array([4.0, 0.0, 0.0]), np.array([-1.0, 0.0, 0.0]))  # the east wall from its back
    first = gauss_mi(two_walls.context(east, behind))
    assert first[1] > 10 * first[0]
    # Unseen space is worth nothing; with coverage it is.
    pure, whole = evaluate_features(("gauss_mi", "gauss_mi_cov"), two_walls.context(*looks)).T
    assert pure[2] == 0.0 and whole[2] > 0.1


def test_revisits_by_hand() -> None:
    here = look_along(np.zeros(3), np.array([1.0, 0.0, 0.0]))
    turned = look_along(np.zeros(3), np.array([1.0, 0.1, 0.0]))  # 6 degrees
    away = look_along(np.array([0.0, 0.31, 0.0]), np.array([1.0, 0.0, 0.0]))
    back = look_along(np.zeros(3), np.array([-1.0, 0.0, 0.0]))
    candidates = np.stack([here, turned, away, back])
    assert revisit_discount(candidates, np.stack([here] * FEW)) == pytest.approx([1.0] * 4)  # too few
    assert revisit_discount(candidates, np.stack([here] * 3)) == pytest.approx([0.05, 0.05, 1.0, 1.0])
    past = np.stack([back, here] + [look_along(np.array([0.0, 0.0, 5.0]), np.array([1.0, 0.0, 0.0]))] * 4)
    assert revisit_discount(candidates, past) == pytest.approx([1 - 0.95**4, 1 - 0.95**4, 1.0, 1 - 0.95**5])
    long_ago = np.concatenate([past, np.repeat(past[-1:], 97, axis=0)])
    assert revisit_discount(candidates, long_ago) == pytest.approx([1.0] * 4)
    newest = np.concatenate([past[2:], past[2:], candidates[:1]])
    assert revisit_discount(candidates, newest) == pytest.approx([1.0] * 4)


def test_the_memory_counts_views_that_were_chosen_and_no_keyframes_on_the_way() -> None:
    config = configure("fast", {"frame_budget": 200, "features": ("gauss_mi",), "keyframe_every": 2})
    episode = Reconstruction(config)
    episode.start(ground_truth_of(load_scene("box")), seed=0)
    while episode.decisions < FEW + 1 and not episode.exhausted:
        episode.move_to(int(np.argmax(np.where(episode.candidates.revisit, -1.0, episode.candidates.path_length))))
    stops = episode.agent.stops
    assert len(stops) == episode.decisions == FEW + 1 < len(episode.keyframe_indices)
    np.testing.assert_array_equal(stops[-1], episode.pose)
    assert revisit_discount(stops[:1], stops)[0] == pytest.approx(1.0 - FORGETTING**FEW)


def test_views_that_were_chosen_are_what_discounts_and_keyframes_are_not(two_walls, looks) -> None:
    context = two_walls.context(*looks)
    keyframes = np.stack([frame.world_from_camera for frame in two_walls.mapper.keyframes] * 2)
    north = np.stack([look_along(np.zeros(3), np.array([0.0, 1.0, 0.0]))] * (FEW + 1))
    stood = [look_along(np.zeros(3), np.array([1.0, 0.0, 0.0]))] * FEW + [north[0]]
    factors = revisit_discount(np.array(looks), np.stack(stood))
    assert factors[0] < 0.5 and factors[1] == 1.0  # the east had been chosen, the west had not
    assert revisit_discount(np.array(looks), keyframes)[1] < 1.0  # and both stand among the keyframes
    found = gauss_mi(two_walls.context(*looks, agent=SimpleNamespace(stops=np.stack(stood))))
    np.testing.assert_allclose(found, gauss_mi(context) * factors, rtol=1e-12)
