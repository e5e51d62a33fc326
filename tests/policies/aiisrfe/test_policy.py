"""The modes of the planner of Zeng et al. and its tour, on views made by hand."""

from __future__ import annotations

import numpy as np

from activestructure_gym.envs.observation import CANDIDATE_COLUMNS
from activestructure_gym.policies.aiisrfe import Aiisrfe
from tests.policies.binding import bound


def views(rows: list[tuple], near: int, total: int) -> dict[str, np.ndarray]:
    """Rows of (x, way, frontier, uncertainty)."""
    table = np.zeros((len(rows), len(CANDIDATE_COLUMNS)), np.float32)
    for name, column in (("x", 0), ("path_length", 1), ("frames", 1)):
        table[:, CANDIDATE_COLUMNS.index(name)] = [row[column] for row in rows]
    features = np.array([[frontier, near, total, unsure] for _, _, frontier, unsure in rows], np.float32)
    return {"candidates": table, "candidate_features": features, "action_mask": np.ones(len(rows), np.int8)}


# x, way, frontier, uncertainty: unsure surface beside the agent, a frontier at 3 m and one at -4 m.
ROWS = [(0.5, 0.5, -1, 0.9), (3.0, 3.0, 0, 0.0), (-4.0, 4.0, 1, 0.0), (0.6, 0.6, -1, 0.1)]


def test_many_near_frontiers_and_nothing_else_is_gone_to() -> None:
    policy = bound(Aiisrfe())
    assert policy.act(views(ROWS, near=4, total=10)) == 1 and policy.trace()["mode"] == "explore"
    # 3 are not more than 3, and 4 of 20 are not more than a fifth: surface on the way is a task, too.
    for near, total in ((3, 3), (4, 20)):
        policy.reset(0)
        assert policy.act(views(ROWS, near, total)) == 0 and policy.trace()["mode"] == "both"


def test_without_frontiers_the_surface_is_left_and_without_that_the_nearest_view() -> None:
    policy = bound(Aiisrfe())
    rows = [(x, way, -1, unsure) for x, way, _, unsure in ROWS]
    assert policy.act(views(rows, 0, 0)) == 0 and policy.trace()["mode"] == "reconstruct"
    policy.reset(0)
    assert policy.act(views([(x, way, -1, 0.0) for x, way, *_ in ROWS], 0, 0)) == 0
    masked = views(ROWS, near=4, total=4)
    masked["action_mask"][[1, 2]] = 0  # near frontiers that nobody can go to
    policy.reset(0)
    assert policy.act(masked) == 0


def test_without_a_tour_unsure_surface_counts_where_no_near_frontier_can_be_gone_to() -> None:
    rows = views([(0.6, 0.6, -1, 0.1), (0.7, 0.7, -1, 0.9), (3.0, 3.0, 0, 0.0)], near=4, total=4)
    rows["action_mask"][2] = 0
    policy = bound(Aiisrfe(travel="shared"))
    assert policy.act(rows) == 1 and policy.trace()["mode"] == "reconstruct"


def test_the_tour_and_not_the_nearest_task_decides() -> None:
    # First the one at 2 m to the left, then all on the right: 2 + 2 + 3 + 1 instead of 1.9 + 3.9 + 4.
    rows = [(1.9, 1.9, 0, 0.0), (-2.0, 2.0, 1, 0.0), (6.0, 6.0, 2, 0.0), (7.0, 7.0, 3, 0.0)]
    policy = bound(Aiisrfe())
    assert policy.act(views(rows, 4, 4)) == 1
    assert bound(Aiisrfe(travel="shared")).act(views(rows, 4, 4)) == 0


def test_tasks_of_surface_stand_apart() -> None:
    from activestructure_gym.policies.aiisrfe.policy import most_uncertain

    policy = bound(Aiisrfe())
    places = [(0.0, 0.9), (0.5, 0.8), (1.5, 0.7), (3.0, 0.6), (9.0, 0.5), (12.0, 0.0)]
    crowd = [(x, 1.0, -1, unsure) for x, unsure in places]
    observed = views(crowd, 0, 0)
    rows = most_uncertain(policy.candidates(observed), observed["candidate_features"][:, 3])
    assert rows == [0, 2, 3]


def test_the_tour_is_gone_before_it_is_planned_anew_and_tasks_are_found_again_by_their_place() -> None:
    policy = bound(Aiisrfe())
    rows = [(-2.0, 2.0, 0, 0.0), (1.0, 1.0, 1, 0.0), (9.0, 9.0, 2, 0.0)]
    assert policy.act(views(rows, 4, 4)) == 0 and policy.trace()["left"] == 1  # 2 m, then 3 m back: 5 of 13 m
    # Much unsure surface beside the agent is no reason to leave the tour; its view is not on offer any longer.
    later = [(-1.9, 0.1, -1, 0.9), (1.2, 3.2, -1, 0.0), (9.0, 11.0, 2, 0.0)]
    assert policy.act(views(later, 3, 3)) == 1 and policy.trace()["left"] == 0
    assert policy.act(views(later, 3, 3)) == 0
