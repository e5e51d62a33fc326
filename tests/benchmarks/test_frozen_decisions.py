import dataclasses

import numpy as np
import pytest

from benchmarks.frozen_decisions import (
    Settings,
    _scored,
    decision_rows,
    quality_rows,
    run_decisions_benchmark,
)


def record(scene, rate, best=1.0, pool=2.0, **more):
    picks = {"a": {"row": 4, "rate": rate, "best_of_first": best, "rank_correlation": 0.5}}
    return {
        "scene": scene,
        "seed": 0,
        "table": {"best": best, "mean": 0.1},
        "pool": {"best": pool},
        "picks": picks,
    } | more


def test_shares_by_hand_every_scene_counts_the_same():
    records = [record("x", 0.2), record("x", 0.4), record("y", 0.9), record("y", 0.0, best=0.0, pool=0.0)]
    rows = {row["pick"]: row for row in decision_rows(records)}
    # (mean(.2, .4) + .9) / 2; the last record has nothing on offer and does not count.
    assert rows["a"]["of_the_table's_best"] == pytest.approx(0.6) and rows["a"]["decisions"] == 3
    assert rows["a"]["of_the_pool's_best"] == pytest.approx(0.3)
    half = 12.7062 * 0.3  # of two scenes, .3 and .9: standard error .3, one degree of freedom
    assert rows["a"]["interval"] == pytest.approx((0.6 - half, 0.6 + half), abs=1e-4)
    assert rows["a"]["best_of_own_first_8"] == 1.0 and rows["a"]["rank_correlation"] == 0.5
    assert rows["any row, at random"]["of_the_table's_best"] == pytest.approx(0.1)
    assert rows["best of the table"]["of_the_table's_best"] == 1.0
    assert rows["best of the table"]["of_the_pool's_best"] == 0.5
    assert decision_rows(records[:2])[1]["interval"] is None  # a single scene
    assert decision_rows(records[3:]) == []


def test_a_pick_its_first_rows_and_its_order():
    rates = np.array([0.1, 0.4, 0.3, 0.2])
    perfect = _scored(rates, np.array([1, 2, 3, 0]))
    assert perfect["rate"] == 0.4 and perfect["rank_correlation"] == pytest.approx(1.0)
    reverse = _scored(rates, np.array([0, 3, 2, 1]))
    assert (reverse["rate"], reverse["best_of_first"]) == (0.1, 0.4) and reverse["rank_correlation"] == pytest.approx(
        -1
    )
    assert _scored(rates, np.array([3])) == {"row": 3, "rate": 0.2}
    assert _scored(rates, np.array([9])) == {"row": -1, "rate": 0.0}  # a row without a candidate


def test_quality_by_hand():
    quality = {"4": {"psnr": 1.0, "depth_l1_cm": -2.0}, "7": {"psnr": 3.0, "depth_l1_cm": 4.0}}
    rows = {row["pick"]: row for row in quality_rows([record("x", 0.2, quality=quality), record("y", 0.2)])}
    assert rows["a"]["psnr_per_100"] == 1.0 and rows["a"]["depth_l1_cm_per_100"] == -2.0
    assert rows["mean of those mapped"]["psnr_per_100"] == 2.0
    # Less depth error is better.
    assert rows["best of those mapped"]["psnr_per_100"] == 3.0
    assert rows["best of those mapped"]["depth_l1_cm_per_100"] == -2.0
    assert rows["a"]["psnr_of_best"] == pytest.approx(1 / 3) and rows["a"]["depth_l1_cm_of_best"] == 1.0
    assert rows["mean of those mapped"]["depth_l1_cm_of_best"] == pytest.approx(
        -0.5
    )  # 1 cm worse, where 2 less could be
    more = [record("x", 0.2, quality=quality), record("z", 0.2, quality={"4": {"psnr": 4.0}, "7": {"psnr": 1.0}})]
    of_two = {row["pick"]: row for row in quality_rows(more)}["a"]
    assert of_two["psnr_of_best"] == pytest.approx((1 / 3 + 1.0) / 2)
    half = 12.7062 / 3  # standard error 1 / 3, one degree of freedom
    assert of_two["psnr_of_best_interval"] == pytest.approx((2 / 3 - half, 2 / 3 + half), abs=1e-4)
    worse = record("x", 0.2, quality={"4": {"psnr": -1.0}, "7": {"psnr": -2.0}})
    assert quality_rows([worse])[0]["psnr_of_best"] is None  # where nothing mends there is no share


def test_episodes_are_frozen_scored_and_not_played_twice():
    settings = Settings(features=("pixel",), policies=("random",), preset="fast", frames=15, every=1, pool=30)
    (records,) = run_decisions_benchmark(["box"], [0], settings)
    assert {name for r in records for name in r["picks"]} == {"random", "feature pixel"}
    for r in records:
        assert r["pool"]["best"] >= r["table"]["best"] >= max(pick["rate"] for pick in r["picks"].values()) >= 0
        assert r["pool"]["views"] <= 30
    observed = [r["observed"] for r in records]
    assert observed == sorted(observed)
    assert list(run_decisions_benchmark(["box"], [0], settings, done=records)) == []


def test_what_a_view_changes_is_measured_in_a_copy_of_the_map():
    settings = Settings(
        features=("pixel",), policies=("random",), preset="fast", frames=25, every=2, pool=5, quality=3, views=2
    )
    (records,) = run_decisions_benchmark(["box"], [0], settings)
    (plain,) = run_decisions_benchmark(["box"], [0], dataclasses.replace(settings, quality=0))
    assert [r["picks"] for r in records] == [r["picks"] for r in plain]  # the episode goes on as if nothing were mapped
    for r in records:
        assert len(r["quality"]) >= 3 and {str(pick["row"]) for pick in r["picks"].values()} <= set(r["quality"])
        assert all({"psnr", "depth_l1_cm", "completion_ratio"} == set(found) for found in r["quality"].values())
    rows = {row["pick"]: row for row in quality_rows(records)}
    assert (
        rows["best of those mapped"]["completion_ratio_per_100"]
        > rows["mean of those mapped"]["completion_ratio_per_100"]
        > 0
    )
