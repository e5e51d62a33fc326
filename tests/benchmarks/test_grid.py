import pytest

from benchmarks import grid
from benchmarks.command import run
from benchmarks.grid import Grid, run_grid_benchmark


def test_the_overhead_is_the_median_over_pairs(monkeypatch):
    clock, spent = [0.0], [0.0, 0.0]
    walls = iter([10.0, 10.1, 10.4, 10.0, 10.0, 10.3])  # by hand first, then the supervisor first, then by hand

    def way(jobs, directory):
        clock[0] += next(walls)
        spent[0] += 0.2
        spent[1] += 20.0

    monkeypatch.setattr(grid.Comparison, "prepare", lambda self, notify: ["a job"])
    monkeypatch.setattr(grid, "_by_hand", way)
    monkeypatch.setattr(grid, "_supervised", way)
    monkeypatch.setattr(grid.time, "perf_counter", lambda: clock[0])
    monkeypatch.setattr(grid, "_processor_seconds", lambda: tuple(spent))
    *rows, median = run_grid_benchmark(["box"])
    assert [row["overhead_%"] for row in rows] == pytest.approx([1.0, 4.0, 3.0])
    assert median["overhead_%"] == pytest.approx(3.0)
    assert median["overhead_cpu_%"] == pytest.approx(0.0) and median["own_cpu_%"] == pytest.approx(1.0)


@pytest.mark.slow
def test_both_ways_run_the_same_jobs():
    rows = run_grid_benchmark(["box"], frames=8, seeds=(0,), repeats=1)
    assert [row["jobs"] for row in rows] == [2, 2]
    assert all(row[f"{way}_s"] > 0 and row[f"{way}_cpu_s"] > 0 for row in rows for way in ("by_hand", "supervisor"))


def test_both_ways_are_printed(monkeypatch, capsys):
    def measured(scenes, **options):
        return [{"repetition": "1", "scenes": scenes, **{name: options[name] for name in ("frames", "repeats")}}]

    monkeypatch.setattr(grid, "run_grid_benchmark", measured)
    assert run(Grid, ["--quick"]) == 0
    said = capsys.readouterr().out
    assert "the same jobs by hand and through" in said and "box" in said
