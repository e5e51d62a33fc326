"""The further references (active_gs, frontier, rt_guide, view_angle) on tables of three or four views, by hand."""

from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.envs.observation import CANDIDATE_COLUMNS
from activestructure_gym.policies import POLICIES, Planner
from activestructure_gym.policies.active_gs import ActiveGS
from activestructure_gym.policies.frontier import Frontier
from activestructure_gym.policies.rt_guide import RTGuide
from activestructure_gym.policies.view_angle import ViewAngle
from tests.policies.binding import bound, columns

LENGTH, FRAMES = CANDIDATE_COLUMNS.index("path_length"), CANDIDATE_COLUMNS.index("frames")


def observation(features: list, length: list, valid: list | None = None) -> dict[str, np.ndarray]:
    """Ten frames per metre of path."""
    table = np.array(features, np.float32).reshape(len(length), -1)
    candidates = np.zeros((len(length), len(CANDIDATE_COLUMNS)), np.float32)
    candidates[:, LENGTH], candidates[:, FRAMES] = length, 10 * np.array(length)
    mask = np.ones(len(length), np.int8) if valid is None else np.array(valid, np.int8)
    return {"candidates": candidates, "candidate_features": table, "action_mask": mask}


@pytest.mark.parametrize(("kind", "gain"), [(ActiveGS, "confidence"), (Frontier, "unexplored")])
def test_shares_of_gain_less_half_the_share_of_the_way(kind: type[Planner], gain: str) -> None:
    assert kind.required_features == (gain,)
    # Shares of the gain 0.3, 0.3, 0.4; of the way 0.3, 0.1, 0.6: 0.15, 0.25, 0.1.
    seen = observation([3.0, 3.0, 4.0], [3.0, 1.0, 6.0])
    np.testing.assert_allclose(
        kind().native_scores(seen["candidate_features"][:, 0], seen), [0.15, 0.25, 0.1], rtol=1e-6
    )
    assert bound(kind()).act(seen) == 1
    assert bound(kind()).act(observation([3.0, 3.0, 6.0], [3.0, 1.0, 6.0])) == 1  # 0.25 - 0.05, 0.5 - 0.3
    assert bound(kind()).act(observation([2.0, 2.0, 6.0], [3.0, 1.0, 6.0])) == 2  # 0.2 - 0.05, 0.6 - 0.3
    # What is masked takes no share: alone, the first two have 0.5 each.
    masked = observation([3.0, 3.0, 4.0], [3.0, 1.0, 6.0], [1, 1, 0])
    np.testing.assert_allclose(
        kind().native_scores(masked["candidate_features"][:, 0], masked)[:2], [0.125, 0.375], rtol=1e-6
    )
    # With everybody's term the last one is worth 4 / 13, the second 3 / 3.
    shared, native = bound(kind("shared")), bound(kind())
    assert shared.act(seen) == native.act(seen) == 1
    assert shared.trace() == {gain: 3.0, "travel": pytest.approx(1 / 3)}
    assert native.trace() == {gain: 3.0, "path_length": 1.0}


def test_active_gs_goes_far_for_a_little_more_where_all_ways_are_long() -> None:
    """Its pathology: a way costs by what it is of the mean way, and where most are long that is little."""
    features, length = np.full(100, 1.0), np.full(100, 8.0)
    features[0], length[0] = 0.9, 0.5  # beside the agent
    features[1], length[1] = 1.1, 12.0
    seen = observation(features.tolist(), length.tolist())
    assert bound(ActiveGS()).act(seen) == 0
    features[1] = 1.7
    # 24 times the way for twice the gain
    assert bound(ActiveGS()).act(observation(features.tolist(), length.tolist())) == 1
    assert bound(ActiveGS("shared")).act(observation(features.tolist(), length.tolist())) == 0


def test_without_any_gain_the_nearest_view_is_taken() -> None:
    nothing = observation([0.0, 0.0, 0.0], [3.0, 1.0, 0.5], [1, 1, 0])
    for kind in (ActiveGS, Frontier):
        assert bound(kind()).act(nothing) == bound(kind("shared")).act(nothing) == 1


def test_view_angle_takes_the_newest_side_however_far() -> None:
    seen = observation([0.3, 0.4, 0.5], [0.1, 1.0, 30.0])
    assert bound(ViewAngle()).act(seen) == 2
    assert bound(ViewAngle("shared")).act(seen) == 0


# Columns: xi, Omega, cuboid.
VIEWS = [[0.0, 0.010, 4], [0.2, 0.010, 4], [0.5, 0.030, 7], [0.9, 0.080, 9]]


def test_rt_guide_chooses_a_region_by_its_way_and_then_the_view() -> None:
    policy = bound(RTGuide())
    # Omega / e^d: 0.010 / e^0.5 = 0.0061, 0.030 / e^2 = 0.0041, 0.080 / e^3 = 0.0040: the first region, and in it the
    # better view though it is farther away.
    assert policy.act(observation(VIEWS, [0.5, 2.5, 2.0, 3.0])) == 1
    assert policy.trace() == {"rt_guide": pytest.approx(0.2), "region": pytest.approx(0.01), "cuboid": 4}
    assert policy.act(observation(VIEWS, [1.5, 1.8, 2.0, 3.0])) == 2  # 0.0022
    assert policy.act(observation(VIEWS, [1.5, 1.8, 2.0, 2.0])) == 3  # 0.0108
    assert policy.act(observation(VIEWS, [0.5, 2.5, 2.0, 3.0], [1, 0, 1, 1])) == 0


def test_rt_guide_stays_where_it_is_while_much_moves_farther_away() -> None:
    """Its pathology: e^-d outweighs any uncertainty that is some metres off."""
    assert bound(RTGuide()).act(observation([[0.1, 0.001, 1], [0.9, 0.1, 2]], [0.1, 6.0])) == 0


def test_rt_guide_where_nothing_moves_and_where_all_ways_are_very_long() -> None:
    still = [[-0.1, 0.0, 4], [0.2, 0.0, 4], [0.5, 0.0, 7]]
    assert bound(RTGuide()).act(observation(still, [0.5, 2.5, 2.0])) == 1  # the nearest region, its best view
    assert bound(RTGuide()).act(observation(VIEWS, [900.0, 990.0, 899.0, 950.0])) == 2
    # little is more than none
    assert bound(RTGuide()).act(observation([[0.0, 0.0, 1], [0.0, 1e-30, 2]], [0.1, 800.0])) == 1


def test_rt_guide_shared_counts_xi_from_the_lowest() -> None:
    # 0, 0.3 / 3, 0.6 / 11 of -0.1, 0.2, 0.5; a masked row is not the lowest.
    seen = observation([[-0.1, 0, 4], [0.2, 0, 4], [0.5, 0, 7], [-5.0, 0, 7]], [0.5, 1.0, 5.0, 0.5], [1, 1, 1, 0])
    assert bound(RTGuide("shared")).act(seen) == 1


REVISIT = CANDIDATE_COLUMNS.index("revisit")


@pytest.mark.parametrize("name", ["active_gs", "frontier", "gs_planner", "hgs_planner", "rt_guide"])
@pytest.mark.parametrize("travel", ["native", "shared"])
def test_a_revisit_is_gone_to_only_where_nothing_else_is_on_offer(name: str, travel: str) -> None:
    policy = bound(POLICIES.get(name)(travel))
    row = {"rt_guide": [0.9, 0.5, 4.0]}.get(name, [0.9] * len(columns(policy)))
    better = observation([row, [0.1 * row[0], *row[1:]], row], [0.0, 2.0, 0.0], [1, 1, 0])
    better["pose"] = np.array([0, 0, 0, 0.5, 0.5, 0.5, 0.5], np.float32)
    assert policy.act(better) == 0
    better["candidates"][0, REVISIT] = 1.0
    policy.reset(0)
    assert policy.act(better) == 1
    assert better["action_mask"].tolist() == [1, 1, 0]
    better["action_mask"][1] = 0
    assert policy.act(better) == 0


def test_shares_are_those_among_the_views_that_are_no_revisits() -> None:
    # 0.30 - 0.5 * 0.1, 0.70 - 0.5 * 0.9; a long revisit would make the difference of the ways small: 0.29, 0.61.
    seen = observation([3.0, 7.0, 0.0], [1.0, 9.0, 90.0])
    assert bound(Frontier()).act(seen) == 1
    seen["candidates"][2, REVISIT] = 1.0
    seen["candidate_features"][1] = 5.0  # 0.375 - 0.05, 0.625 - 0.45
    assert bound(Frontier()).act(seen) == 0


def test_of_views_from_new_sides_only_the_nearest_is_taken() -> None:
    seen = observation([0.9, 1.0, 1.0, 1.0], [0.1, 5.0, 2.0, 1.0], [1, 1, 1, 0])
    assert bound(ViewAngle()).act(seen) == 2
    assert bound(ViewAngle()).act(observation([0.0, 0.0], [5.0, 2.0])) == 1
