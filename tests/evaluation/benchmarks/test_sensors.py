import numpy as np
import pytest

from activestructure_gym.evaluation.benchmarks import sensors as benchmark
from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.ground_truth import ground_truth_of


class Clockwork:
    """A renderer whose picture takes a known time on the clock of the test."""

    def __init__(self, name, seconds, clock, log):
        self.name, self.seconds, self.clock, self.log = name, seconds, clock, log

    def render(self, camera, world_from_camera, *, supersample=2):
        self.log.append((self.name, supersample))
        self.clock[0] += self.seconds

    def close(self):
        self.log.append((self.name, "closed"))


@pytest.fixture
def clock(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(benchmark.time, "perf_counter", lambda: now[0])
    return now


def test_rounds_are_interleaved_and_the_first_is_not_counted(clock):
    log = []
    renderers = [Clockwork("a", 0.25, clock, log), Clockwork("b", 0.5, clock, log)]
    seconds = benchmark.time_renderers(
        renderers, PinholeCamera.from_size(4, 3), np.stack([np.eye(4)] * 2), repeats=3, supersample=2
    )
    np.testing.assert_array_equal(seconds, [[0.25] * 6, [0.5] * 6])
    assert len(log) == 2 * 4 * 2
    assert all({log[i][0], log[i + 1][0]} == {"a", "b"} for i in range(0, len(log), 2))


def test_rows_of_the_table(clock, monkeypatch, box_room):
    log = []
    monkeypatch.setattr(benchmark, "benchmark_views", lambda scene, count, rng: np.stack([np.eye(4)] * count))
    monkeypatch.setattr(benchmark, "renderer_status", lambda: {"raycast": "works", "pyrender": "works"})
    speed = {"auto": 0.125, "raycast": 0.25, "pyrender": 0.5}
    monkeypatch.setattr(benchmark, "make_renderer", lambda name, scene: Clockwork(name, speed[name], clock, log))
    rows = benchmark.run_sensor_benchmark([box_room], sizes=((8, 4), (16, 8)), repeats=2, views=3, supersample=1)
    assert [(row["size"], row["triangles"], row["frames"]) for row in rows] == [("8x4", 12, 6), ("16x8", 12, 6)]
    for row in rows:
        assert row["auto_fps"] == 8.0 and row["auto_p10_p90"] == (8.0, 8.0) and row["raycast_fps"] == 4.0
        assert row["pyrender_fps"] == 2.0
        assert row["ratio"] == 4.0  # pyrender takes four times as long
    assert log.count(("raycast", "closed")) == log.count(("pyrender", "closed")) == 1


def test_without_opengl_its_columns_say_so(clock, monkeypatch, box_room):
    monkeypatch.setattr(benchmark, "benchmark_views", lambda scene, count, rng: np.stack([np.eye(4)] * count))
    monkeypatch.setattr(benchmark, "renderer_status", lambda: {"raycast": "works", "pyrender": "no libEGL"})
    monkeypatch.setattr(benchmark, "make_renderer", lambda name, scene: Clockwork(name, 0.25, clock, []))
    (row,) = benchmark.run_sensor_benchmark([box_room], sizes=((8, 4),), repeats=1, views=1)
    assert row["auto_fps"] == row["raycast_fps"] == 4.0
    assert row["pyrender_fps"] is None and row["ratio"] is None and row["note"] == "no libEGL"


def test_views_are_where_an_agent_could_be():
    from activestructure_gym.scenes.library import load_scene

    scene = load_scene("box")
    views = benchmark.benchmark_views(scene, 20, np.random.default_rng(0))
    space = ground_truth_of(scene).free_space
    assert space.clearance_at(views[:, :3, 3]).min() > 0.2  # 0.3 m, less one voxel of interpolation
    assert np.degrees(np.arcsin(views[:, 2, 2])).min() > -31 and np.degrees(np.arcsin(views[:, 2, 2])).max() < 16
    np.testing.assert_array_equal(views, benchmark.benchmark_views(scene, 20, np.random.default_rng(0)))


def test_counts_below_one_are_refused():
    with pytest.raises(ValueError, match="at least 1"):
        benchmark.run_sensor_benchmark([], repeats=0)
