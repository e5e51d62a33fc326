"""The modes of the planner of Zeng et al. and its tour, on views made by hand."""

from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.envs.observation import CANDIDATE_COLUMNS
from activestructure_gym.policies.aiisrfe import Aiisrfe
from tests.policies.binding import bound


def views(rows: list[tuple]) -> dict[str, np.ndarray]:
    """Rows of (x, path, frontier, uncertainty)."""
    table = np.zeros((len(rows), len(CANDIDATE_COLUMNS)), np.float32)
    for name, column in (("x", 0), ("path_length", 1), ("frames", 1)):
        table[:, CANDIDATE_COLUMNS.index(name)] = [row[column] for row in rows]
    features = np.array([row[2:] for row in rows], np.float32)
    return {"candidates": table, "candidate_features": features, "action_mask": np.ones(len(rows), np.int8)}


UNSURE = (0.5, 0.5, -1, 0.9)  # a view of unsure surface next to the agent


def mode(frontiers: list[float]) -> str:
    """The first plan, with frontiers at paths of these lengths."""
    policy = bound(Aiisrfe())
    policy.act(views([UNSURE, *((metres, metres, n, 0.0) for n, metres in enumerate(frontiers))]))
    return str(policy.trace()["mode"])


def test_two_frontiers_within_a_metre_and_15_percent_of_all_leave_no_other_task() -> None:
    assert mode([0.9, 0.99]) == "explore"
    assert mode([0.9, 1.0]) == "both"
    assert mode([0.9, 0.9, *[5.0] * 11]) == "explore"  # 2 of 13
    assert mode([0.9, 0.9, *[5.0] * 12]) == "both"  # 2 of 14
    # 4 of 12 frontiers 2 to 3 m away are not near.
    assert mode([2.0, 2.3, 2.6, 2.9, *[6.0] * 8]) == "both"


@pytest.mark.parametrize("travel", ["native", "shared"])
def test_after_two_mixed_plans_only_frontiers_are_tasks(travel: str) -> None:
    """Every plan has the surface next to the agent or a frontier 6 m away as its first task."""
    policy, seen = bound(Aiisrfe(travel)), views([UNSURE, (6.0, 6.0, 0, 0.0)])
    modes, chosen = [], []
    for _ in range(6):
        chosen.append(policy.act(seen))
        modes.append(policy.trace()["mode"])
    assert modes == ["both", "both", "explore"] * 2
    assert chosen == [0, 0, 1] * 2


def test_surface_is_a_task_within_1_5_metres_and_4_without_frontiers() -> None:
    policy = bound(Aiisrfe())
    rows = [(1.6, 1.6, -1, 0.9), (1.4, 1.4, -1, 0.1), (-9.0, 9.0, 0, 0.0)]
    assert policy.act(views(rows)) == 1 and policy.trace()["mode"] == "both"
    for path, expected in ((3.9, 1), (4.1, 0)):
        alone = [(1.0, 1.0, -1, 0.0), (path, path, -1, 0.9)]
        policy = bound(Aiisrfe())
        assert policy.act(views(alone)) == expected  # beyond 4 m there is no task: the nearest view
        assert policy.trace()["mode"] == "reconstruct"


@pytest.mark.parametrize("travel", ["native", "shared"])
def test_reconstruction_is_for_good_once_no_frontier_was_left(travel: str) -> None:
    """Tables of 256 rows, of which three suffice; the frontier is much nearer than the surface."""
    near, surface = (0.2, 0.2, 0, 0.0), (2.0, 2.0, -1, 0.9)
    with_frontier = views([near, surface, *[(9.0, 9.0, -1, 0.0)] * 254])
    without = views([(*near[:2], -1, 0.0), surface, *[(9.0, 9.0, -1, 0.0)] * 254])
    for tables, expected in ((2, "both"), (3, "reconstruct")):
        policy = bound(Aiisrfe(travel))
        for _ in range(tables):
            assert policy.act(without) == 1
        policy.act(with_frontier)
        assert policy.trace()["mode"] == expected


def test_a_frontier_that_cannot_be_reached_is_no_task() -> None:
    masked = views([UNSURE, (0.8, 0.8, 0, 0.0), (0.9, 0.9, 1, 0.0)])
    masked["action_mask"][1:] = 0
    for travel in ("native", "shared"):
        policy = bound(Aiisrfe(travel=travel))
        assert policy.act(masked) == 0 and policy.trace()["mode"] == "reconstruct"


def test_the_tour_and_not_the_nearest_task_decides() -> None:
    # First the one at 2 m to the left, then all on the right: 2 + 2 + 3 + 1 instead of 1.9 + 3.9 + 4.
    rows = [(1.9, 1.9, 0, 0.0), (-2.0, 2.0, 1, 0.0), (6.0, 6.0, 2, 0.0), (7.0, 7.0, 3, 0.0)]
    policy = bound(Aiisrfe())
    assert policy.act(views(rows)) == 1
    assert bound(Aiisrfe(travel="shared")).act(views(rows)) == 0


def test_tasks_of_surface_stand_apart() -> None:
    from activestructure_gym.policies.aiisrfe.policy import most_uncertain

    policy = bound(Aiisrfe())
    places = [(0.0, 0.9), (0.5, 0.8), (1.5, 0.7), (3.0, 0.6), (9.0, 0.5), (12.0, 0.0)]
    crowd = [(x, 1.0, -1, unsure) for x, unsure in places]
    observed = views(crowd)
    rows = most_uncertain(policy.candidates(observed), observed["candidate_features"][:, 1])
    assert rows == [0, 2, 3]


def test_the_tour_is_gone_before_it_is_planned_anew_and_tasks_are_found_again_by_their_place() -> None:
    policy = bound(Aiisrfe())
    rows = [(-2.0, 2.0, 0, 0.0), (1.0, 1.0, 1, 0.0), (9.0, 9.0, 2, 0.0)]
    assert policy.act(views(rows)) == 0 and policy.trace()["left"] == 1  # 2 m, then 3 m back: 5 of 13 m
    # Much unsure surface beside the agent is no reason to leave the tour; its view is not on offer any longer.
    later = [(-1.9, 0.1, -1, 0.9), (1.2, 3.2, -1, 0.0), (9.0, 11.0, 2, 0.0)]
    assert policy.act(views(later)) == 1 and policy.trace()["left"] == 0
    assert policy.act(views(later)) == 0
