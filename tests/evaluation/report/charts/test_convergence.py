import re

import numpy as np
import pytest

from activestructure_gym.evaluation.report.charts.convergence import (
    areas,
    chart_rows,
    convergence,
    curve_of,
    measures_of,
)
from activestructure_gym.evaluation.report.results import Results


def test_turning_in_place_costs_no_metres_so_the_last_value_counts(make_run):
    run = make_run()
    run.metrics["curve"][:] = [
        {"decision": 0, "frames": 1, "metres": 0.0, "psnr": 5.0},
        {"decision": 1, "frames": 9, "metres": 0.0, "psnr": 7.0},
        {"decision": 3, "frames": 20, "metres": 2.0, "psnr": 8.0},
    ]
    np.testing.assert_array_equal(curve_of(run, "metres", "psnr"), [[0.0, 2.0], [7.0, 8.0]])
    np.testing.assert_array_equal(curve_of(run, "frames", "psnr"), [[1, 9, 20], [5, 7, 8]])
    # Seconds at the end of decisions 1 and 3; the first frame is there at once.
    np.testing.assert_array_equal(curve_of(run, "seconds", "psnr"), [[0.0, 2.0, 6.0], [5, 7, 8]])


def test_a_line_per_policy_with_the_mean_over_the_scenes(make_run):
    runs = [make_run(scene, policy, seed, completion_ratio=80.0 if scene == "room" else 40.0)
            for scene in ("room", "box") for policy in ("a", "b") for seed in range(2)]  # fmt: skip
    first, second = convergence(Results(runs, []), "frames", "completion_ratio")
    assert (first.name, second.name, second.index) == ("a", "b", 1)
    assert (first.x[0], first.x[-1]) == (1.0, 100.0)
    assert first.y[-1] == 60.0 and first.low[-1] == first.high[-1] == 60.0  # both seeds are alike
    (alone,) = convergence(Results(runs[:1], []), "frames", "psnr", "room")
    assert alone.low is None


def test_charts_side_by_side_have_one_vertical_axis(make_run):
    runs = [make_run(policy="a", completion_ratio=40.0), make_run(policy="b", seconds=90.0, metres=90.0)]
    runs[0].timing["decisions"] = [1.0, 1.5, 2.0]
    rows = chart_rows(Results(runs, []))
    ranges = [[re.search(r'data-y="([^"]+)"', chart).group(1) for chart in row] for row in rows]
    assert [len(row) for row in rows] == [3, 3] and all(len(set(own)) == 1 for own in ranges)
    assert ranges[0] != ranges[1]


def test_one_slow_run_does_not_make_a_chart_of_its_tail(make_run):
    runs = [make_run(policy=policy, seed=seed) for policy in "ab" for seed in range(3)]
    runs[0].timing["decisions"] = [2.0, 4.0, 90.0]
    runs[0].metrics["curve"][-1] |= {"completion_ratio": 60.0}  # whose last decision brought nothing
    for run in runs[1:3]:
        run.metrics["curve"][:] = [point | {"completion_ratio": 60.0} for point in run.metrics["curve"]]
    frames, _, seconds = chart_rows(Results(runs, []))[0]
    assert float(re.search(r'data-x="\S+ ([^"]+)"', frames).group(1)) == 100.0
    assert 6.0 <= float(re.search(r'data-x="\S+ ([^"]+)"', seconds).group(1)) < 10.0
    assert convergence(Results(runs, []), "seconds", "completion_ratio")[0].x[-1] == 90.0


def test_a_policy_without_runs_on_a_scene_has_no_line_over_all(make_run):
    runs = [make_run("room", "a"), make_run("box", "a"), make_run("room", "b")]
    results = Results(runs, [])
    assert [line.name for line in convergence(results, "frames", "psnr")] == ["a"]
    assert [line.name for line in convergence(results, "frames", "psnr", "room")] == ["a", "b"]
    assert areas(results, "b", "frames", "psnr") is None


def test_areas_end_at_the_budget_or_with_the_cheapest_run(make_run):
    cheap, dear = make_run(policy="a", metres=6.0), make_run(policy="b", metres=12.0)
    results = Results([cheap, dear], [])
    # Over frames 1, 34, 67, 100 the ratio is 20, 40, 60, 80; before the first frame it is 20.
    expected = (20 * 1 + 33 * (30 + 50 + 70)) / 100
    assert areas(results, "a", "frames", "completion_ratio")[0] == pytest.approx(expected)
    # Over metres both end at 6: the cheap one has its mean there, the dear one half of its way.
    assert areas(results, "a", "metres", "completion_ratio")[0] == pytest.approx(50.0)
    assert areas(results, "b", "metres", "completion_ratio")[0] == pytest.approx((20 + 40) / 2 * 4 / 6 + 45 * 2 / 6)
    still = make_run(policy="c", metres=0.0)  # never moved, so it is no budget for the others
    with_it = Results([cheap, dear, still], [])
    assert areas(with_it, "a", "metres", "completion_ratio")[0] == pytest.approx(50.0)
    assert areas(with_it, "c", "metres", "completion_ratio")[0] == pytest.approx(80.0)


def test_a_measure_has_points_where_it_was_taken_and_charts_where_any_run_has_it(make_run):
    run, old = make_run(policy="a"), make_run(policy="b")
    for point, observed in zip(run.metrics["curve"], (10.0, 40.0, 60.0, 70.0)):
        point["observed"] = observed
    run.metrics["curve"][0]["known_m3"] = 5.0
    run.metrics["curve"][-1]["known_m3"] = 65.0
    np.testing.assert_array_equal(curve_of(run, "frames", "observed"), [[1, 34, 67, 100], [10, 40, 60, 70]])
    np.testing.assert_array_equal(curve_of(run, "frames", "known_m3"), [[1, 100], [5, 65]])
    assert len(curve_of(old, "frames", "observed")[0]) == 0
    both = Results([run, old], [])
    assert [m.key for m in measures_of(both)] == ["completion_ratio", "observed", "psnr", "known_m3"]
    assert [m.key for m in measures_of(Results([old], []))] == ["completion_ratio", "psnr"]
    assert [line.name for line in convergence(both, "frames", "observed")] == ["a"]
    assert len(chart_rows(both)) == 4
    assert areas(both, "b", "frames", "observed") is None
