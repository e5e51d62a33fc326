"""ActiveGAMER: its travel factor, its lattice, its pool and what ends its stages."""

from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.envs.observation import CANDIDATE_COLUMNS, row_columns
from activestructure_gym.geometry import look_along
from activestructure_gym.policies import make_env_and_policy
from activestructure_gym.policies.activegamer.policy import (
    COARSE_DIRECTIONS,
    END,
    GOOD_PSNR,
    MAX_VISITS,
    POOL_SHARE,
    SOURCES,
    STAGNATION,
    ActiveGAMER,
    coarse_views,
    travel_factor,
)
from activestructure_gym.policies.activegamer.policy import ROWS as ROWS_OFFERED
from activestructure_gym.policies.base import patience
from activestructure_gym.policies.scored import recorded_scores
from tests.policies.binding import bound

FORWARD = (1.0, 0.0, 0.0)
ROWS = 256  # of a whole table, the rest of it masked; fewer rows need more decisions to end a stage
PATIENCE = patience(ROWS)


def observation(
    gain: list[float],
    positions: list[tuple[float, float, float]],
    looks: list[tuple[float, float, float]] | None = None,
    *,
    here: tuple[float, float, float] = (0.0, 0.0, 0.0),
    frames: list[float] | None = None,
    revisit: tuple[int, ...] = (),
    fidelity: float = 20.0,
) -> dict[str, np.ndarray]:
    table = np.zeros((len(gain), len(CANDIDATE_COLUMNS)), np.float32)
    table[:, :3] = positions
    table[:, 3:6] = [FORWARD] * len(gain) if looks is None else looks
    table[:, CANDIDATE_COLUMNS.index("frames")] = 5.0 if frames is None else frames
    table[list(revisit), CANDIDATE_COLUMNS.index("revisit")] = 1.0
    return {
        "candidates": table,
        "candidate_features": np.array(gain, np.float32)[:, None],
        "action_mask": np.ones(len(gain), np.int8),
        "pose": np.array([*here, 1, 0, 0, 0], np.float32),
        "fidelity": np.array([fidelity, 30.0], np.float32),
    }


def whole(table: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the observation with masked rows up to ROWS."""
    more = ROWS - len(table["action_mask"])
    rows = ("candidates", "candidate_features", "action_mask")
    return table | {name: np.pad(table[name], ((0, more), (0, 0))[: table[name].ndim]) for name in rows}


def policy(travel: str = "native", stage: int = 1) -> ActiveGAMER:
    made = bound(ActiveGAMER(travel))
    made.reset(0)
    made._stage = stage
    return made


def cells(count: int) -> list[tuple[float, float, float]]:
    return [(float(i), 0.0, 0.0) for i in range(count)]


def test_the_travel_factor_by_hand() -> None:
    # e^0 : e^(ln 3) = 1 : 3
    np.testing.assert_allclose(travel_factor(np.array([0.0, np.log(3.0)])), [0.75, 0.25])
    np.testing.assert_allclose(travel_factor(np.full(4, 7.0)), 0.75)
    assert travel_factor(np.array([900.0, 901.0])) == pytest.approx(travel_factor(np.array([0.0, 1.0])))  # no overflow


def test_pathology_the_travel_factor_is_nearly_inert(rng: np.random.Generator) -> None:
    """With 100 views the gain given up for distance is at most 1.4 % in 95 of 100 cases."""
    given_up = []
    for _ in range(300):
        gain, distance = rng.uniform(0, 1, 100), rng.uniform(0, 6, 100)
        chosen = (gain * travel_factor(distance)).argmax()
        given_up.append(1.0 - gain[chosen] / gain.max())
    assert np.quantile(given_up, 0.95) < 0.02
    # Only what is alone in being far is held back, and that entirely.
    outlier = travel_factor(np.append(rng.uniform(0, 6, 99), 14.0))
    assert outlier[-1] < 0.05
    assert outlier[:-1].min() > 0.998


def test_native_travel_is_hardly_felt_and_shared_travel_is() -> None:
    seen = observation([0.80, 0.81, *[0.1] * 30], [(0.5, 0, 0), (4.5, 0, 0), *[(5.0, i, 0) for i in range(30)]])
    seen["candidates"][1, CANDIDATE_COLUMNS.index("frames")] = 45.0
    assert policy().act(seen) == 1
    assert policy("shared").act(seen) == 0


def test_coarse_views_by_hand() -> None:
    azimuth = 2 * np.pi * 2 / ((1 + np.sqrt(5)) / 2)
    level = (np.cos(azimuth), np.sin(azimuth), 0.0)  # the third of five Fibonacci directions
    offset = np.array([(0, 0, 0), (1, -1, 0), (1.25, -1, 0), (0.5, 0, 0), (-0.5, 0, 0), (0.75, 0, 0.5)], float)
    names, away = coarse_views(offset, np.tile(level, (6, 1)))
    assert names.tolist() == [[0, 0, 2], [1, -1, 2], [1, -1, 2], [1, 0, 2], [0, 0, 2], [1, 0, 2]]
    np.testing.assert_allclose(away, [0, 0, 0.25, 0.5, 0.5, np.hypot(0.25, 0.5)], atol=1e-6)
    assert set(coarse_views(np.zeros((200, 3)), np.random.default_rng(0).normal(size=(200, 3)))[0][:, 2]) == set(
        range(COARSE_DIRECTIONS)
    )


def test_the_coarse_stage_takes_the_nearest_to_each_lattice_view_and_the_fine_stage_all() -> None:
    # Rows 0 and 1 stand for the lattice position 1 m ahead; row 1 stands on it, row 0 would gain more.
    seen = observation([0.9, 0.5, 0.1], [(1.2, 0, 0), (1.0, 0, 0), (0.0, 0, 0)])
    assert policy(stage=0).act(seen) == 1
    assert policy(stage=1).act(seen) == 0
    # The lattice stays where the episode began.
    coarse = policy(stage=0)
    coarse.act(seen)
    seen["pose"][:3] = (0.2, 0.0, 0.0)
    assert coarse.act(seen) == 1


def test_poor_views_leave_the_pool_and_never_return() -> None:
    poor, rich = 0.9 * POOL_SHARE, 2.0 * POOL_SHARE
    made = policy()
    assert made.act(observation([poor, poor / 2], cells(2))) == 0  # below the threshold, and chosen for want of better
    grown = observation([0.9, 0.8, rich], cells(3))  # both were pruned, whatever they show by this time
    assert made.act(grown) == 2
    # In the next stage the whole lattice is offered again.
    made._stage = 0
    made._begin_stage()
    assert made.act(grown) == 0


def test_poor_views_are_scored_once_and_then_leave_the_pool() -> None:
    """Views at 1, 5 and 9 m with 2, 3 and 0.4 % score 0.370, 0.546 and 0.001; without the last, 0.393 and 0.011."""
    gain, places = [0.02, 0.03, 0.004], [(1.0, 0, 0), (5.0, 0, 0), (9.0, 0, 0)]
    columns, table = lattice_views(1, [(place[0], share) for place, share in zip(places, gain)])
    native = on_lattices(columns)
    native._stage = native._active = 1
    for made, seen in ((policy(), observation(gain, places)), (native, table)):
        for choice, wanted in ((1, [0.37025, 0.54557, 0.00136]), (0, [0.39281, 0.01079, -np.inf])):
            with recorded_scores() as compared:
                assert made.act(seen) == choice
            np.testing.assert_allclose(compared[-1].scores[:3], wanted, atol=1e-5)


def test_a_poor_pool_earns_one_move_and_an_empty_one_gives_way_to_what_else_is_on_offer() -> None:
    # Both stand for one view of the coarse lattice, row 0 nearer to it: the pool is row 0 alone.
    made, seen = policy(stage=0), observation([0.9 * POOL_SHARE, 0.9], [(1.0, 0, 0), (1.3, 0, 0)])
    for choice, pool in ((0, 1), (1, 0)):
        assert made.act(seen) == choice
        assert made.trace()["pool"] == pool


def test_stages_change_when_the_pool_is_empty_and_refinement_takes_the_worst_keyframe() -> None:
    made = policy(stage=0)
    barren = whole(observation([0.0, 0.001, 0.9, 0.9], cells(4), revisit=(2, 3), frames=[1.0, 1.0, 9.0, 1.0]))
    stages = []
    for _ in range(2 * PATIENCE):
        choice = made.act(barren)
        stages.append(made.trace()["stage"])
    assert stages == ["coarse"] * (PATIENCE - 1) + ["fine"] * PATIENCE + ["post-refinement"]
    assert choice == 2  # of the revisits the worst, which is offered first; no distance in it
    shared = policy("shared", stage=2)
    assert shared.act(barren) == 3
    # Nine tenths of the keyframes render well: discovery again, with what there is.
    made._begin_stage()
    assert made.act({**barren, "fidelity": np.array([GOOD_PSNR, 40.0], np.float32)}) == 1
    assert made.act(observation([0.0, 0.3], cells(2))) == 1  # nothing to revisit on offer


def test_a_small_table_shows_less_of_the_pool_and_needs_more_decisions() -> None:
    made, stages = policy(stage=0), []
    for _ in range(patience(64) + 1):
        made.act(observation([0.0] * 64, cells(64)))
        stages.append(made.trace()["stage"])
    assert stages == ["coarse"] * 11 + ["fine"] * 2


def test_one_view_worth_going_to_keeps_the_stage() -> None:
    made = policy(stage=0)
    for decision in range(3 * PATIENCE):
        shown = 0.5 if decision % PATIENCE == 0 else 0.0
        made.act(whole(observation([shown, 0.0], [(10.0 + decision, 0, 0), (0, 0, 0)])))
        assert made.trace()["stage"] == "coarse"


def test_pathology_it_returns_to_windows_until_a_guard_rail_stops_it() -> None:
    """What looks out of a window stays uncovered whatever is mapped, and the best of the pool for ever."""
    made = policy()
    chosen = []
    for decision in range(10):
        # The same window from the same place, and a real but smaller gap somewhere else in every decision.
        chosen.append(made.act(observation([0.6, 0.2], [(0, 0, 0), (2.0 + decision, 0, 0)])))
    assert chosen == [0] * MAX_VISITS + [1] * (10 - MAX_VISITS)
    # From ever new places the cap on visits does not help; the stage ends all the same.
    made = policy()
    for decision in range(STAGNATION + 1):
        assert made.trace().get("stage", "fine") == "fine"
        made.act(observation([0.6], [(2.0 * decision, 0, 0)]))
    assert made.trace()["stage"] == "post-refinement"
    assert "no progress" in made.trace()["changed"]


def test_a_stage_goes_on_while_its_views_get_covered_whatever_the_best_one_shows() -> None:
    """Views of a new room keep the largest share high for as long as there are some."""
    columns, _ = lattice_views(0, [])
    native, shared = on_lattices(columns), policy()
    for decision in range(3 * STAGNATION):
        # A view loses 1 % at once, then 0.1 % at a time, which is progress every five decisions.
        lost = POOL_SHARE * (2.0 + 0.2 * (decision - STAGNATION)) if decision >= STAGNATION else 0.0
        shares = [0.9, 0.8 - lost]
        assert native.act(lattice_views(0, [(1.0, shares[0]), (2.0, shares[1])])[1]) in (0, 1)
        shared.act(whole(observation(shares, [(0.02 * decision, 0, 0), (2.0, 0, 0)])))
        assert native.trace()["stage"] == "coarse" and shared.trace()["stage"] == "fine"


def test_a_share_that_rises_and_falls_again_is_no_progress() -> None:
    columns, _ = lattice_views(0, [])
    native, shared = on_lattices(columns), policy()
    for decision in range(STAGNATION + 1):
        assert native.trace().get("stage", "coarse") == "coarse" and shared.trace().get("stage", "fine") == "fine"
        shares = [0.9, 0.8 + 2.0 * POOL_SHARE * (decision % 2)]
        native.act(lattice_views(0, [(1.0, shares[0]), (2.0, shares[1])])[1])
        shared.act(whole(observation(shares, [(0.02 * decision, 0, 0), (2.0, 0, 0)])))
    assert native.trace()["stage"] != "coarse" and shared.trace()["stage"] != "fine"


def test_nothing_uncovered_at_all_is_no_error_and_leaves_the_choice_to_the_distance() -> None:
    # ln 0 and 0 / 0 in the original.
    made = policy()
    assert made.act(observation([0.0, 0.0, 0.0], [(3.0, 0, 0), (1.0, 0, 0), (5.0, 0, 0)])) == 1


def lattice_views(stage: int, rows: list[tuple], psnr: float = 20.0) -> tuple[tuple, dict[str, np.ndarray]]:
    """Rows of (x, uncovered share) of the stage's own source, which stays in stage 2, and two that ask for others."""
    columns = row_columns(ActiveGAMER.native_settings.stages)
    others = [s for s in range(3) if s != stage]
    table = np.zeros((len(rows) + len(others), len(columns)), np.float32)
    for row, (x, _) in enumerate(rows):
        table[row, columns.index("x")] = x
        table[row, columns.index("look_x")] = 1.0
        table[row, columns.index(f"from_{SOURCES[stage]}")] = 1.0
        table[row, columns.index("stay")] = float(stage == 2)
    for row, other in enumerate(others):
        table[len(rows) + row, columns.index(f"ask_{other}")] = 1.0
    features = np.array([[share] for _, share in rows] + [[0.0]] * len(others), np.float32)
    return columns, {
        "candidates": table, "candidate_features": features, "action_mask": np.ones(len(table), np.int8),
        "pose": np.array([0, 0, 0, 0.5, 0.5, 0.5, 0.5], np.float32), "fidelity": np.array([psnr, psnr], np.float32),
    }  # fmt: skip


def on_lattices(columns: tuple) -> ActiveGAMER:
    policy = bound(ActiveGAMER())
    policy._rows = columns
    return policy


def test_a_poor_view_does_not_prune_the_one_beside_it() -> None:
    """A stand-in did: both are within the cell of one view of the coarse lattice, and look the same way."""
    columns, poor = lattice_views(0, [(0.2, 0.001), (3.0, 0.2)])
    policy = on_lattices(columns)
    assert policy.act(poor) == 1
    _, exact = lattice_views(0, [(0.0, 0.1), (3.0, 0.002)])
    assert policy.act(exact) == 0
    # What was poor itself stays out for good.
    _, again = lattice_views(0, [(0.2, 0.9), (0.0, 0.1)])
    assert policy.act(again) == 1


@pytest.mark.parametrize(
    ("rows", "moves"), [(ROWS_OFFERED[0] - 1, 1), (ROWS_OFFERED[0], patience(ROWS_OFFERED[0]) - 1)]
)
def test_a_full_table_is_a_draw_and_needs_several_decisions_to_end_a_stage(rows: int, moves: int) -> None:
    columns, poor = lattice_views(0, [(float(n), 0.001) for n in range(rows)])
    policy = on_lattices(columns)
    for _ in range(moves):
        assert policy.act(poor) < rows and policy.trace()["stage"] == "coarse"
    assert policy.act(poor) == rows  # asks for the fine stage


def test_stages_follow_each_other_and_refinement_stands_still() -> None:
    columns, empty = lattice_views(0, [(1.0, 0.001)])
    policy = on_lattices(columns)
    assert policy.act(empty) == 0  # one last move, from which there may be new free places
    assert policy.act(empty) == 1  # the coarse pool is empty: asks for the fine one
    _, fine = lattice_views(1, [(1.0, 0.001), (2.0, 0.3)])
    assert policy.act(fine) == 1 and policy.trace()["stage"] == "fine"
    _, poor = lattice_views(1, [(2.0, 0.0)])
    assert policy.act(poor) == 0
    assert policy.act(poor) == 2  # asks for post-refinement
    for _ in range(3):
        _, stay = lattice_views(2, [(0.0, 0.0)])
        with recorded_scores() as compared:
            assert policy.act(stay) == 0 and policy.trace()["stage"] == "post-refinement"
        assert np.isneginf(compared[-1].scores[1:]).all()  # requests for other stages are not compared
    _, good = lattice_views(2, [(0.0, 0.0)], psnr=35.0)
    good["candidates"] = np.vstack([good["candidates"], np.zeros((1, len(columns)), np.float32)])
    good["candidates"][-1, columns.index(f"from_{END}")] = 1.0
    good["candidate_features"] = np.vstack([good["candidate_features"], [[0.0]]]).astype(np.float32)
    good["action_mask"] = np.ones(4, np.int8)
    assert policy.act(good) == 3 and policy.trace()["stage"] == "end"  # the original's run is done
    good["action_mask"][3] = 0
    assert policy.act(good) == 0  # not yet offered


@pytest.mark.parametrize("scene", ["box", "room"])
def test_exploration_begins_around_the_start_although_no_image_shows_it(scene: str) -> None:
    small = {"sensor": {"width": 48, "height": 27}, "mapper.iterations": 1}
    env, policy = make_env_and_policy("activegamer", scene, setup="native", preset="fast", config=small)
    policy.reset(0)
    drawn = env.reset(seed=0)[0]["pose"][:3].astype(float)
    # 0.25 m below the coarse lattice, which would be out of reach of a low camera.
    start_pose = look_along(np.array([*drawn[:2], 1.5]), np.array([1.0, 0.0, 0.0]))
    observation, _ = env.reset(seed=0, options={"start_pose": start_pose})
    start = observation["pose"].copy()
    choice = policy.act(observation)
    assert policy.trace()["stage"] == "coarse" and policy.trace()["pool"] > 0
    observation, *_ = env.step(choice)
    assert np.abs(observation["pose"] - start).max() > 0.1
    env.close()
