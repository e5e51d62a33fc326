"""GS-Planner: its sum, the nearest viewpoints, and the library of views left behind."""

from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.envs.observation import CANDIDATE_COLUMNS
from activestructure_gym.policies.gs_planner.policy import (
    MIN_GAIN,
    QUALITY_WEIGHT,
    SPACING_M,
    STORED_GAIN,
    VIEWPOINTS,
    GSPlanner,
    best_per_viewpoint,
    overlap,
)
from tests.policies.binding import bound

AHEAD, BACK = (1.0, 0.0, 0.0), (-1.0, 0.0, 0.0)


def observation(
    gain: list[float],  # of volume
    x: list[float],  # metres; the path is as long
    loss: list[float] | None = None,
    looks: list[tuple[float, float, float]] | None = None,
) -> dict[str, np.ndarray]:
    table = np.zeros((len(gain) + 1, len(CANDIDATE_COLUMNS)), np.float32)  # the last row is masked
    table[:-1, 0] = table[:-1, CANDIDATE_COLUMNS.index("path_length")] = x
    table[:-1, CANDIDATE_COLUMNS.index("frames")] = 10.0 * np.array(x)
    table[:-1, 3:6] = [AHEAD] * len(gain) if looks is None else looks
    features = np.ones((len(gain) + 1, 2), np.float32)
    features[:-1, 0], features[:-1, 1] = gain, 0.0 if loss is None else loss
    return {
        "candidates": table,
        "candidate_features": features,
        "action_mask": np.array([1] * len(gain) + [0], np.int8),
    }


def policy(travel: str = "native") -> GSPlanner:
    made = bound(GSPlanner(travel))
    made.reset(0)
    return made


def test_the_sum_by_hand() -> None:
    seen = observation([0.30, 0.28], [1.0, 2.0], loss=[0.1, 0.1 + 0.03 / QUALITY_WEIGHT])
    made = policy()
    assert made.act(seen) == 1  # 0.28 + 0.04 against 0.30 + 0.01
    assert made.trace()["volume"] == pytest.approx(0.28)
    seen["candidate_features"][1, 1] = 0.1 + 0.01 / QUALITY_WEIGHT
    assert made.act(seen) == 0


def test_overlap_by_hand() -> None:
    here = np.array([[0.0, 0, 0, *AHEAD]])
    side = (np.cos(np.pi / 4), np.sin(np.pi / 4), 0.0)
    others = np.array([[0, 0, 0, *AHEAD], [1.0, 0, 0, *AHEAD], [0, 0, 0, *side], [1.0, 0, 0, *side], [0, 0, 0, *BACK]])
    np.testing.assert_allclose(overlap(here, others), [[1.0, 0.5, 0.5, 0.25, 0.0]], atol=1e-9)


def test_every_viewpoint_gives_its_best_view_nearest_first_and_keeps_its_distance() -> None:
    x = np.array([2.0, 1.0, 2.0, 1.0, 1.0 + 0.9 * SPACING_M, 9.0])
    positions = np.pad(x[:, None], ((0, 0), (0, 2)))
    rows = best_per_viewpoint(positions, x, np.array([0.1, 0.2, 0.15, 0.1, 0.3, 0.05]))
    assert rows.tolist() == [4, 5]  # all but the last stand around the place 1 m ahead
    assert best_per_viewpoint(4 * positions, x, np.array([0.1, 0.2, 0.3, 0.1, 0.0, 0.1])).tolist() == [1, 2, 5]
    many = np.pad(2 * SPACING_M * np.arange(3.0 * VIEWPOINTS)[:, None], ((0, 0), (0, 2)))
    assert best_per_viewpoint(many, many[:, 0], many[:, 0]).tolist() == list(range(VIEWPOINTS))


def test_native_looks_no_farther_than_the_nearest_viewpoints_and_shared_weighs_the_way() -> None:
    x = [3.0 * (i + 1) for i in range(VIEWPOINTS)] + [30.0]
    seen = observation([0.1] * (VIEWPOINTS - 1) + [0.2, 0.8], x)
    assert policy().act(seen) == VIEWPOINTS - 1  # 0.8 lies one place too far
    # 0.1 / 7 at 30 frames, 0.2 / 25 at 120, 0.8 / 61 at 300
    assert policy("shared").act(seen) == 0
    seen["candidate_features"][VIEWPOINTS, 0] = 0.9
    assert policy("shared").act(seen) == VIEWPOINTS


def test_views_left_behind_are_come_back_to_and_forgotten() -> None:
    made = policy()
    near = observation([0.5, 0.3, 0.9 * STORED_GAIN], [0.0, 4.0, 8.0])
    assert made.act(near) == 0
    assert made.trace()["library"] == 1  # 4 m ahead; 8 m ahead is not worth storing
    # At the end of a corridor: nothing near is worth a view, and of what is far the stored one is, to half a metre.
    poor = [0.5 * MIN_GAIN] * VIEWPOINTS
    x = [30.0 + 2.0 * i for i in range(VIEWPOINTS)]
    far = observation([*poor, 0.2, 0.9], [*x, 60.0, 65.0])
    far["candidates"][VIEWPOINTS, 0] = 4.5
    assert made.act(far) == VIEWPOINTS
    assert made.trace()["from"] == "library"
    assert made.trace()["library"] == 0
    # The library is empty: the best of all.
    assert made.act(far) == VIEWPOINTS + 1
    assert made.trace()["from"] == "all"


def test_a_stored_view_that_lost_its_gain_leaves_and_one_not_on_offer_stays() -> None:
    made = policy()
    made.act(observation([0.5, 0.3, 0.3], [0.0, 4.0, 20.0]))
    assert made.trace()["library"] == 2
    poor = [0.5 * MIN_GAIN] * VIEWPOINTS
    barren = observation([*poor, 0.5 * MIN_GAIN], [*[30.0 + 2.0 * i for i in range(VIEWPOINTS)], 60.0])
    barren["candidates"][VIEWPOINTS, 0] = 4.0
    made.act(barren)
    assert made.trace() == {"volume": pytest.approx(0.01), "loss": 0.0, "from": "all", "library": 1}


def test_pathology_it_stays_with_small_near_gains_while_most_is_far() -> None:
    """Nothing weighs the near against the far as long as the near is worth anything at all."""
    gain = [1.5 * MIN_GAIN] * VIEWPOINTS + [0.9] * 20
    seen = observation(gain, [2.0 * i for i in range(len(gain))])
    assert policy().act(seen) < VIEWPOINTS


def test_in_a_room_something_is_left_for_the_library() -> None:
    """Were all places of a room near ones, the library would only be asked when there is nothing in it either."""
    axes = np.arange(0.5, 5.6, 0.5), np.arange(0.5, 4.6, 0.5), np.array([1.0, 1.5, 2.0])
    places = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    ways = np.linalg.norm(places - [1.0, 1.0, 1.5], axis=1)
    # The gain grows with the distance, so that of every place the farthest view stands for it.
    rows = best_per_viewpoint(places, ways, ways)
    assert ways[rows].max() < 0.7 * ways.max()
    assert (np.linalg.norm(places[:, None] - places[rows], axis=2).min(axis=1) > SPACING_M).mean() > 0.25
