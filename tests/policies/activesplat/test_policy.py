"""ActiveSplat: its integer score, its subregions, and when it looks around instead of going on."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from activestructure_gym.envs.observation import CANDIDATE_COLUMNS
from activestructure_gym.policies.activesplat import nodes as module
from activestructure_gym.policies.activesplat.nodes import RICH, Nodes, node_scores
from activestructure_gym.policies.activesplat.policy import (
    LATE_AFTER,
    LOCAL_DEG2,
    LOCAL_VIEWS,
    STOP_M,
    UNARRIVED_M,
    ActiveSplat,
)
from activestructure_gym.policies.anm_s.targets import DEFERRED_M
from tests.policies.binding import bound, columns

COLUMNS = columns(ActiveSplat)
AHEAD, BACK = (1.0, 0.0, 0.0), (-1.0, 0.0, 0.0)


def nodes(count: int = 3, **changes: Any) -> Nodes:
    values: dict[str, Any] = {
        "rows": tuple(np.array([n]) for n in range(count)),
        "places": np.column_stack([np.arange(1.0, count + 1.0), np.zeros(count)]),
        "information": np.zeros(count),
        "volume": np.zeros(count),
        "unarrived": np.ones(count, bool),
        "horizon": np.zeros(count, bool),
        "failed": np.zeros(count, bool),
        "region": np.ones(count),
        "length": np.arange(1.0, count + 1.0),
        "here": np.zeros(count, bool),
        "stop": np.zeros(count, bool),
        "near_stop": np.zeros(count, bool),
    }
    return Nodes(**{**values, **{name: np.array(value) for name, value in changes.items()}})


def choose_node(known: Nodes, scores: np.ndarray, late: np.random.Generator | None = None) -> int:
    """The choice of an agent at the origin."""
    return module.choose_node(known, scores, np.zeros(2), late)


def test_the_score_by_hand() -> None:
    known = nodes(
        information=[400.0, 100.0, 0.0], volume=[2.0, 4.0, 0.0], unarrived=[True, False, True],
        horizon=[False, True, False], failed=[False, False, True],
    )  # fmt: skip
    # 20 + 2 x 10 + 5; 10 + 2 x ceil(2.5) + 10; 20 - 60
    assert node_scores(known).tolist() == [45, 26, -40]


def test_a_node_near_a_stop_counts_in_other_subregions_and_not_in_the_agents() -> None:
    """B is 0.3 m from a stop and in the horizon, with 10 and 10 tenths of I and V; C is unarrived, with 2 and 2."""
    known = {
        "information": [500.0, 100.0, 0.0], "volume": [5.0, 1.0, 0.0], "unarrived": [False, True, False],
        "horizon": [True, False, False], "near_stop": [True, False, True],
    }  # fmt: skip
    elsewhere = nodes(**known, region=[2, 3, 1], here=[False, False, True], length=[4.0, 5.0, 0.0])
    assert node_scores(elsewhere).tolist() == [40, 26, 0]
    assert choose_node(elsewhere, node_scores(elsewhere)) == 0
    known["information"] = [500.0, 300.0, 0.0]
    around = nodes(**known, region=[1, 1, 1], here=[False, False, True], length=[4.0, 5.0, 0.0])
    assert node_scores(around).tolist() == [40, 34, 0]
    assert choose_node(around, node_scores(around)) == 1


def test_a_subregion_is_not_ranked_by_its_stops() -> None:
    known = nodes(horizon=[True, False, False], stop=[True, False, False], region=[2, 3, 1], length=[2.0, 3.0, 1.0])
    assert node_scores(known).tolist() == [30, 20, 20]
    assert choose_node(known, node_scores(known)) == 1


def test_the_late_score_by_hand() -> None:
    known = nodes(
        information=[400.0, 100.0, 400.0], volume=[2.0, 4.0, 0.0], unarrived=[False, False, True],
        horizon=[False, True, True], failed=[False, False, True],
    )  # fmt: skip
    # 10 x 10 + 10 x 5; 10 x 3 + 10 x 10 - 1; 20 + 10 x 10 - 1 - 60
    assert node_scores(known, late=True).tolist() == [150, 129, 59]


def test_nothing_missing_anywhere_is_no_division_by_zero() -> None:
    assert node_scores(nodes()).tolist() == [20, 20, 20]


def test_a_subregion_is_finished_before_the_next() -> None:
    known = nodes(information=[1.1 * RICH, 9.0 * RICH, 0.0], region=[1, 2, 1])
    scores = node_scores(known)
    assert scores.tolist() == [24, 40, 20]
    assert choose_node(known, scores) == 0
    # A node that the path passed stays rich if the agent has not stopped near it: 4 against 20.
    passed = nodes(information=[1.1 * RICH, 9.0 * RICH, 0.0], region=[1, 2, 1], unarrived=[False, True, False])
    assert node_scores(passed).tolist() == [4, 40, 0]
    assert choose_node(passed, node_scores(passed)) == 0
    # The agent has stopped near its rich node, or it is no longer rich, or failed.
    for change in ({"near_stop": [True, False, False]}, {"information": [0.9 * RICH, 9.0 * RICH, 0.0]},
                   {"failed": [True, False, False]}):  # fmt: skip
        changed = nodes(**{"information": [1.1 * RICH, 9.0 * RICH, 0.0], "region": [1, 2, 1], **change})
        assert choose_node(changed, node_scores(changed)) == 1


def test_without_a_rich_node_here_it_goes_to_another_subregion_if_one_is_worth_it() -> None:
    known = nodes(information=[0.9 * RICH, 0.0, 0.0], region=[1, 2, 1])
    assert node_scores(known).tolist() == [40, 20, 20]
    assert choose_node(known, node_scores(known)) == 1
    failed = nodes(information=[0.9 * RICH, 0.0, 0.0], region=[1, 2, 1], failed=[False, True, False])
    assert choose_node(failed, node_scores(failed)) == 0  # 20 - 60 there


def test_the_node_the_agent_stands_at_is_no_goal_unless_it_is_the_only_one() -> None:
    known = nodes(information=[9.0 * RICH, 2.0 * RICH, 0.0], here=[True, False, False])
    assert choose_node(known, node_scores(known)) == 1
    # Nor does its riches keep the agent in the subregion.
    known = nodes(information=[9.0 * RICH, 0.0, 0.0], here=[True, False, False], region=[1, 1, 2])
    assert choose_node(known, node_scores(known)) == 2
    alone = nodes(1, here=[True])
    assert choose_node(alone, node_scores(alone)) == 0


def test_late_it_draws_among_equals_and_defers_nothing(rng: np.random.Generator) -> None:
    known = nodes(4, length=[1.0, 2.0, DEFERRED_M + 1.0, 3.0])
    drawn = {choose_node(known, np.array([7, 7, 7, 6]), rng) for _ in range(50)}
    assert drawn == {0, 1, 2}


def test_ties_go_to_the_shortest_way_and_the_far_is_deferred() -> None:
    assert choose_node(nodes(length=[3.0, 2.0, 4.0]), np.array([7, 7, 7])) == 1
    far = nodes(length=[1.0, 5.0, DEFERRED_M + 1.0])
    assert choose_node(far, np.array([1, 2, 9])) == 1
    alone = nodes(length=[DEFERRED_M + 2.0, DEFERRED_M + 3.0, DEFERRED_M + 1.0])
    assert choose_node(alone, np.array([1, 2, 9])) == 2


def test_the_subregion_is_chosen_first_however_far_it_is() -> None:
    """B has 45 points at 14 m, C has none at 4 m, and each is alone in its subregion."""
    known = nodes(places=[[14.0, 0.0], [4.0, 0.0], [0.0, 0.0]], length=[14.0, 4.0, 0.0], region=[2, 3, 1],
                  here=[False, False, True])  # fmt: skip
    assert choose_node(known, np.array([45, 0, 0])) == 0


def observation(
    positions: list[tuple[float, float]],
    *,
    node: list[int],
    show: list[float],
    looks: list[tuple[float, float, float]] | None = None,
    information: list[float] | None = None,
    visited: list[float] | None = None,
    here: tuple[float, float] = (0.0, 0.0),
    places: list[tuple[float, float]] | None = None,
) -> dict[str, np.ndarray]:
    """The agent looks along +x. ``places`` are the nodes of the views, by default the views themselves."""
    count = len(positions)
    table = np.zeros((count, len(CANDIDATE_COLUMNS)), np.float32)
    table[:, :2] = positions
    table[:, 3:6] = [AHEAD] * count if looks is None else looks
    table[:, CANDIDATE_COLUMNS.index("path_length")] = np.linalg.norm(np.subtract(positions, here), axis=1)
    table[:, CANDIDATE_COLUMNS.index("frames")] = 10.0 * table[:, CANDIDATE_COLUMNS.index("path_length")] + 1.0
    features = np.zeros((count, len(COLUMNS)), np.float32)
    for name, values in {
        "voronoi_node": node,
        "visited_distance": [2 * UNARRIVED_M] * count if visited is None else visited,
        "activesplat_information": [1.0] * count if information is None else information,
        "activesplat_region": [1.0] * count,
        "activesplat_view": show,
        "activesplat_x": [x for x, _ in places or positions],
        "activesplat_y": [y for _, y in places or positions],
    }.items():
        features[:, COLUMNS.index(name)] = values
    return {
        "candidates": table,
        "candidate_features": features,
        "action_mask": np.ones(count, np.int8),
        "pose": np.array([*here, 0.0, 0.5, 0.5, 0.5, 0.5], np.float32),
    }


def policy(travel: str = "native") -> ActiveSplat:
    made = bound(ActiveSplat(travel))
    made.reset(0)
    return made


def test_it_looks_around_before_it_goes_on_but_not_for_ever() -> None:
    rich = 2.0 * LOCAL_DEG2
    seen = observation(
        [(0.5, 0.0), (0.0, 0.5), (3.0, 0.0), (3.0, 0.5)], node=[-1, -1, 0, 0], show=[rich, rich + 1.0, 5.0, 9.0],
        looks=[BACK, AHEAD, AHEAD, AHEAD],
    )  # fmt: skip
    seen["pose"][3:] = (0.5, -0.5, 0.5, -0.5)  # along +x, as the camera of look_along is turned
    made = policy()
    chosen, modes = [], []
    for _ in range(LOCAL_VIEWS + 2):
        chosen.append(made.act(seen))
        modes.append(made.trace()["mode"])
        seen["pose"][:3] = seen["candidates"][chosen[-1], :3]
    # Row 1 would show more, but the agent looks that way already. At the node the view that shows most.
    # From there the gaps of the first stop are out of reach, and there is no other node.
    assert chosen == [0] * LOCAL_VIEWS + [3, 3]
    assert modes == ["local"] * LOCAL_VIEWS + ["node", "node"]
    poor = observation([(0.5, 0.0), (3.0, 0.0)], node=[-1, 0], show=[0.9 * LOCAL_DEG2, 0.0], looks=[BACK, AHEAD])
    assert policy().act(poor) == 1


def test_nothing_is_missing_at_a_stop_and_all_of_it_beside_one() -> None:
    positions = [(2.09, 0.0), (2.11, 0.0), (2.64, 0.0), (2.66, 0.0)]
    seen = observation(positions, node=[0, 1, 2, 3], show=[0.0] * 4, information=[9.0] * 4)
    made = policy()
    made._stop, made._stop_node, made._failed = np.zeros(3), np.array([2.0, 0.0]), np.array([[2.55, 0.0]])
    found = made._nodes(made.candidates(seen), np.ones(4, bool))
    assert found.information.tolist() == [0.0, 9.0, 9.0, 9.0]
    assert found.stop.tolist() == [True, False, False, False]
    assert found.near_stop.tolist() == [True, True, True, False]
    assert found.failed.tolist() == [False, False, True, False]


@pytest.mark.parametrize("travel", ["native", "shared"])
def test_it_goes_on_to_where_it_has_not_stopped(travel: str) -> None:
    seen = observation(
        [(2.0, 0.0), (4.0, 0.0), (6.0, 0.0)], node=[0, 1, 2], show=[9.0, 5.0, 5.0], information=[9.0, 1.0, 1.0],
        visited=[0.0, 2 * UNARRIVED_M, 2 * UNARRIVED_M],
    )  # fmt: skip
    seen["candidate_features"][:, COLUMNS.index("in_horizon")] = [1.0, 0.0, 0.0]
    made, chosen = policy(travel), []
    for _ in range(3):
        chosen.append(made.act(seen))
        seen["pose"][:3] = seen["candidates"][chosen[-1], :3]
        lengths = np.linalg.norm(seen["candidates"][:, :2] - seen["pose"][:2], axis=1)
        seen["candidates"][:, CANDIDATE_COLUMNS.index("path_length")] = lengths
        seen["candidates"][:, CANDIDATE_COLUMNS.index("frames")] = 10.0 * lengths + 1.0
    assert chosen == [0, 1, 2]  # and not back to the first, whose riches are more


def test_local_views_stay_around_the_stop() -> None:
    """Each view is within reach of the one before, but the second is not within reach of the stop."""
    seen = observation(
        [(0.7, 0.0), (1.4, 0.0), (5.0, 0.0)], node=[-1, -1, 0], show=[2 * LOCAL_DEG2, 9 * LOCAL_DEG2, 0.0],
        looks=[BACK, BACK, AHEAD],
    )  # fmt: skip
    made = policy()
    assert made.act(seen) == 0
    seen["pose"][:3] = seen["candidates"][0, :3]
    seen["candidates"][:, CANDIDATE_COLUMNS.index("path_length")] = [0.0, 0.7, 4.3]
    assert made.act(seen) == 0
    # Nor do views count that are near, but behind a wall.
    seen["candidates"][0, CANDIDATE_COLUMNS.index("path_length")] = 5.0
    assert made.act(seen) == 2


@pytest.mark.parametrize(("away", "mode"), [(STOP_M - 0.01, "node"), (STOP_M + 0.01, "local")])
def test_a_stop_near_an_earlier_one_has_no_local_views(away: float, mode: str) -> None:
    """The distance of 0.3 m is that of their nodes."""
    seen = observation(
        [(0.3, 0.0), (0.6, 0.0), (5.0, 0.0)], node=[-1, 0, 1], show=[2 * LOCAL_DEG2, 0.0, 0.0],
        looks=[BACK, AHEAD, AHEAD], information=[0.0, 9.0, 1.0], places=[(0.3, 0.0), (away, 0.0), (5.0, 0.0)],
    )  # fmt: skip
    made = policy()
    for expected in [0] * LOCAL_VIEWS + [1]:
        assert made.act(seen) == expected
        seen["pose"][:3] = seen["candidates"][expected, :3]
    made.act(seen)
    assert made.trace()["mode"] == mode


def test_revisits_are_neither_local_views_nor_stand_for_a_node() -> None:
    seen = observation([(0.5, 0.0), (3.0, 0.0), (3.0, 0.5)], node=[-1, 0, 0], show=[500.0, 90.0, 1.0],
                       looks=[BACK, AHEAD, AHEAD])  # fmt: skip
    seen["candidates"][:2, CANDIDATE_COLUMNS.index("revisit")] = 1.0
    assert policy().act(seen) == 2
    seen["candidate_features"][:, COLUMNS.index("voronoi_node")] = -1.0
    assert policy().act(seen) == 2  # nor are they taken where there is no node


def test_the_late_stage_begins_after_some_decisions_lasts_and_forgives() -> None:
    positions = [(1.0, 0.0), (2.0, 0.0), (3.0, 0.0), (4.0, 0.0)]
    seen = observation(positions, node=[0, 1, 2, 3], show=[0.0] * 4, visited=[0.0] * 4)
    made = policy()
    made._failed = np.array([[4.0, 0.0]])
    chosen, late = [], []
    for _ in range(30):
        chosen.append(made.act(seen))
        late.append(made.trace()["late"])
        seen["pose"][:3] = seen["candidates"][chosen[-1], :3]
    assert late == [False] * (LATE_AFTER - 1) + [True] * (31 - LATE_AFTER)
    assert set(chosen[LATE_AFTER:]) == {0, 1, 2, 3}
    assert all(a != b for a, b in zip(chosen, chosen[1:]))  # never where it stands
    assert len(made._failed) == 0
    again = observation(positions, node=[0, 1, 2, 3], show=[0.0] * 4)  # all unarrived
    again["pose"][:3] = seen["pose"][:3]
    made.act(again)
    assert made.trace()["late"]
    made.reset(0)
    made.act(again)
    assert not made.trace()["late"]


def test_a_node_that_was_not_reached_has_failed_also_under_another_number() -> None:
    positions = [(2.0, 0.0), (4.0, 0.0), (7.0, 0.0)]
    options = {"show": [0.0] * 3, "information": [9.0, 2.0, 1.0]}
    seen = observation(positions, node=[0, 1, 2], **options)
    made = policy()
    assert made.act(seen) == 0
    assert made.act(seen) == 1  # it stands where it stood
    assert made.act(observation(positions, node=[2, 1, 0], **options, here=(4.0, 0.0))) == 2
    # The other way round: it arrives, and nothing has failed.
    made = policy()
    assert made.act(seen) == 0
    assert made.act(observation(positions, node=[0, 1, 2], **options, here=(2.0, 0.0))) == 1
    assert len(made._failed) == 0


def test_the_stop_after_a_missed_node_is_where_the_agent_stands() -> None:
    """A is missed by 0.3 m. B is 0.45 m from A, where no stop was, and 0.75 m from the agent, so it counts."""
    positions = [(2.0, 0.0), (2.45, 0.0), (5.0, 0.0)]
    options = {"node": [0, 1, 2], "show": [0.0] * 3}
    made = policy()
    assert made.act(observation(positions, **options, information=[9.0, 5.0, 1.0])) == 0
    assert made.act(observation(positions, **options, information=[9.0, 5.0, 1.0], here=(1.7, 0.0))) == 1


def test_shared_travel_weighs_the_score_by_the_frames() -> None:
    positions = [(1.0, 0.0), (1.0, 0.1), (9.0, 0.0)]
    seen = observation(
        positions, node=[0, 0, 1], show=[1.0, 2.0, 0.0], information=[1.0, 1.0, 5.0], visited=[2.0, 2.0, 2.0]
    )
    assert policy().act(seen) == 2  # 20 + 20 against 20 + 4
    assert policy("shared").act(seen) == 1
    with pytest.raises(ValueError, match="travel must be native or shared"):
        policy("none")


def test_pathology_views_that_stand_at_no_node_are_never_gone_to() -> None:
    """However much they would show: the planner sees the plan's nodes, and the views within reach of where it is."""
    seen = observation([(3.0, 0.0), (5.0, 2.0)], node=[0, -1], show=[0.0, 4000.0], information=[0.0, 0.0])
    assert policy().act(seen) == 0
    none = observation([(3.0, 0.0), (5.0, 2.0)], node=[-1, -1], show=[0.0, 4000.0])
    assert policy().act(none) == 1  # unless there is no node at all
