"""The true planes of a mesh and the counting, on scenes where both are known by hand."""

from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.scenes import Scene
from activestructure_gym.scenes.scene import PartLabels, SceneMesh
from benchmarks import planes as benchmark
from benchmarks.command import run
from benchmarks.planes import (
    Planes,
    Tally,
    TruePlanes,
    opencv_detector,
    score_segments,
    true_planes,
)


def scene_of(*rectangles, structural=None):
    """A scene of rectangles, each given by a corner and two edges and being a part of its own."""
    corners = [np.array([c, np.add(c, a), np.add(np.add(c, a), b), np.add(c, b)], float) for c, a, b in rectangles]
    count = len(corners)
    faces = (4 * np.arange(count)[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
    vertices = np.concatenate(corners).astype(np.float32)
    mesh = SceneMesh(
        vertices, faces.astype(np.int32), np.ones_like(vertices), np.zeros((len(vertices), 2), np.float32),
        np.full(len(faces), -1, np.int32),
    )  # fmt: skip
    labels = None
    if structural is not None:
        names = tuple(f"part {k}" for k in range(count))
        labels = PartLabels(np.repeat(np.arange(count, dtype=np.int32), 2), names, np.array(structural))
    return Scene(name="rectangles", mesh=mesh, source="test", labels=labels)


CAMERA = PinholeCamera.from_size(160, 90)
AHEAD = look_along(np.array([0.0, 0, 1.5]), np.array([1.0, 0, 0]))


def wall(x, left=-4.0, width=8.0):
    return ((x, left, -1.0), (0, width, 0), (0, 0, 5.0))


def test_pieces_of_one_plane_are_one_and_a_step_is_two():
    one = true_planes(scene_of(wall(2, -4, 3.9), wall(2, 0.1, 3.9)), CAMERA, AHEAD, noise_scale=0.25)
    assert len(one.planes) == 1
    np.testing.assert_allclose(one.planes[0], [-1, 0, 0, 2.0], atol=1e-5)
    # 3 cm at 2 m: five times the noise-free tolerance, and within 5 mm + 1.5 x 6 mm of a Kinect's fit of both.
    step = scene_of(wall(2, -4, 4.0), wall(2.03, 0, 4.0), structural=[True, False])
    two = true_planes(step, CAMERA, AHEAD, noise_scale=0.25)
    assert two.large.tolist() == [True, True] and not two.clear.any()
    assert sorted(two.structural.tolist()) == [False, True]
    wide = true_planes(scene_of(wall(2, -4, 4.0), wall(2.2, 0, 4.0)), CAMERA, AHEAD, noise_scale=0.25)
    assert wide.clear.tolist() == [True, True]  # too far apart to be joined


def test_what_the_sensor_cannot_tell_apart_is_one_plane():
    step = scene_of(wall(4, -8, 8.0), wall(4.02, 0, 8.0))  # sigma at 4 m: 2.6 cm
    assert len(true_planes(step, CAMERA, AHEAD, noise_scale=0.25).planes) == 2
    assert len(true_planes(step, CAMERA, AHEAD, noise_scale=1.0).planes) == 1


def test_strips_and_what_lies_out_of_range_are_not_clear():
    # A post of 6 cm at 1.5 m is 3 px wide and 90 px high: large, not clear. The wall at 7 m is beyond the detector.
    truth = true_planes(scene_of(wall(7), ((1.5, 0.0, 0.0), (0, 0.06, 0), (0, 0, 3.0))), CAMERA, AHEAD, noise_scale=1.0)
    assert truth.large.tolist() == [True] and truth.clear.tolist() == [False]
    assert (truth.labels >= 0).mean() < 0.03


def test_counting_by_hand():
    labels = np.full((10, 10), -1)
    labels[:5], labels[5:8] = 0, 1
    planes = np.array([[1.0, 0, 0, 0], [0, 1, 0, 0]])
    yes = np.array([True, True])
    truth = TruePlanes(np.ones((10, 10), np.float32), labels, planes, yes, np.array([True, False]), yes)
    found = np.full((10, 10), -1)
    found[:4] = 0  # 40 of 50: found
    found[7:] = 1  # 10 of 30, and 20 of nothing: neither found nor right
    tally = Tally()
    turned = np.array([np.cos(0.1), np.sin(0.1), 0])
    score_segments(found, np.stack([turned, planes[1, :3]]), truth, tally)
    assert (tally.large, tally.found, tally.clear, tally.clear_found) == (2, 1, 1, 1)
    assert (tally.segments, tally.right) == (2, 1)
    assert tally.figures() == pytest.approx(
        {"recall": 0.5, "clear_recall": 1.0, "precision": 0.5, "angle_deg": np.degrees(0.1)}
    )
    score_segments(np.full((10, 10), -1), np.zeros((0, 3)), truth, tally)
    assert (tally.large, tally.found, tally.segments) == (4, 1, 2)


def test_opencv_finds_a_corner():
    detect = opencv_detector(CAMERA, noisy=False)
    if detect is None:
        pytest.skip("this OpenCV has no findPlanes")
    scene = scene_of(wall(2), ((0, -4, 0.6), (4, 0, 0), (0, 8, 0)))
    truth = true_planes(scene, CAMERA, AHEAD, noise_scale=0.25)
    labels, normals = detect(Frame(np.zeros((90, 160, 3), np.uint8), truth.depth, AHEAD, CAMERA))
    tally = Tally()
    score_segments(labels, normals, truth, tally)
    assert tally.clear_found == tally.clear == 2
    assert max(tally.angles) < 0.5


def test_rows_of_a_scene():
    from activestructure_gym.scenes.library import load_scene

    scene = load_scene("box")
    rows = benchmark.detection_rows(scene, sizes=((160, 90),), views=3)
    assert [row["noise"] for row in rows] == ["none", "kinect"]
    for row in rows:
        assert row["clear_recall"] == row["recall"] == 1.0 and row["precision"] == 1.0
        assert row["angle_deg"] < 0.3 and row["ms"] > 0
    (cost,) = benchmark.graph_rows(scene, keyframes=6, candidates=8)
    assert 3 <= cost["nodes"][1] <= 6
    parts = [cost[f"{name}_ms"] for name in ("update", "visibility", "structure", "deficiency")]
    low, high = cost["sum_q1_q3"]
    assert 0 < max(parts) <= high and low <= cost["sum_ms"] <= high


def test_what_is_found_and_what_it_costs_is_printed(monkeypatch, capsys):
    monkeypatch.setattr(benchmark, "detection_rows", lambda scene, **o: [{"scene": scene.name, "recall": 0.125, **o}])
    monkeypatch.setattr(benchmark, "graph_rows", lambda scene, **o: [{"scene": scene.name, "graph_ms": 7.5, **o}])
    assert run(Planes, ["--scenes", "box", "--quick"]) == 0
    out = capsys.readouterr().out
    assert "0.125" in out and "7.5" in out and "320" not in out
