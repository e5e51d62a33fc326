"""Each failure mode is produced alone and must be the one that responds most; holes are found where they are."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from activestructure_gym.planes import (
    QUALITY_MODES,
    MapPoints,
    PlaneNode,
    PlaneSceneGraph,
    PlaneSegment,
    QualityConfig,
    assess_quality,
    find_deficiencies,
)
from activestructure_gym.planes import graph as graph_module
from activestructure_gym.planes.quality import boundary_closure, interior, normal_consistency
from activestructure_gym.planes.surface import SurfaceGrid, disc

# A board of 2.4 x 1.4 m, 2 m in front of the camera and all in view; 2.5 m behind it a wall.
EYE, AHEAD = (0.0, 0.0, 1.5), (1.0, 0.0, 0.0)


def backdrop(rectangles):
    return rectangles().add((4.5, -8, -5), (0, 16, 0), (0, 0, 13))


def whole_board(rectangles):
    return backdrop(rectangles).add((2, -1.2, 0.8), (0, 2.4, 0), (0, 0, 1.4))


def board_with_window(rectangles, half=0.4):
    """The board with a square window around (2, 0, 1.5)."""
    scene = backdrop(rectangles).add((2, -1.2, 0.8), (0, 1.2 - half, 0), (0, 0, 1.4))
    scene.add((2, half, 0.8), (0, 1.2 - half, 0), (0, 0, 1.4))
    scene.add((2, -half, 0.8), (0, 2 * half, 0), (0, 0, 0.7 - half))
    return scene.add((2, -half, 1.5 + half), (0, 2 * half, 0), (0, 0, 0.7 - half))


def board_of(graph):
    """Index of the node at x = 2."""
    state = graph.state
    (index,) = np.flatnonzero((np.abs(state.centroids[:, 0] - 2.0) < 0.1) & (np.abs(state.normals[:, 0]) > 0.9))
    return index


def watch(graph, scene, frames=6, eye=EYE, **options):
    for _ in range(frames):
        graph.update(scene.shoot(eye, AHEAD, **options)[0])
    return graph.state.quality.modes[board_of(graph)]


@pytest.fixture
def good(rectangles, new_graph):
    """The quality vector of the board when nothing is wrong."""
    modes = watch(new_graph(), whole_board(rectangles))
    assert (modes > 0.93).all()
    return modes


def most_harmed(good, bad):
    return QUALITY_MODES[int(np.argmax(good - bad))]


def test_missing_corner_is_coverage(good, rectangles, new_graph):
    scene = backdrop(rectangles).add((2, -1.2, 0.8), (0, 2.4, 0), (0, 0, 0.7))
    scene.add((2, -1.2, 1.5), (0, 1.2, 0), (0, 0, 0.7))
    bad = watch(new_graph(), scene)
    assert most_harmed(good, bad) == "coverage"
    assert bad[0] == pytest.approx(6 / 7, abs=0.03)  # three quarters of the board, its hull seven eighths
    assert np.abs(good - bad)[1:].max() < 0.03


def test_few_pixels_are_density(good, rectangles, new_graph):
    # 48 px across 4 m: a point every 8.3 cm, 144 per m^2 of the 400 wanted.
    bad = watch(new_graph(), whole_board(rectangles), size=(48, 27))
    assert most_harmed(good, bad) == "density"
    assert bad[1] == pytest.approx(0.36, abs=0.05)


def test_noise_is_fit(good, rectangles, new_graph, rng):
    bad = watch(new_graph(2.0), whole_board(rectangles), noise=1.6, rng=rng)
    assert most_harmed(good, bad) == "fit"
    # 1.6 times 6.1 mm at 2 m: exp(-0.97)
    assert bad[2] == pytest.approx(0.38, abs=0.04)
    assert np.delete(good - bad, 2).max() < 0.15


def test_few_keyframes_are_observations(good, rectangles, new_graph):
    bad = watch(new_graph(), whole_board(rectangles), frames=2)
    assert most_harmed(good, bad) == "observations"
    assert bad[3] == pytest.approx(0.4)
    assert np.delete(np.abs(good - bad), 3).max() < 1e-6


def test_edges_that_nobody_followed_are_boundary(good, rectangles, new_graph):
    # From 0.5 m the image shows 1 x 0.56 m of the board and none of its edges.
    bad = watch(new_graph(), whole_board(rectangles), eye=(1.5, 0.0, 1.5))
    assert most_harmed(good, bad) == "boundary"
    assert bad[4] < 0.05
    assert np.delete(good - bad, 4).max() < 0.03


def test_scattered_normals_are_normals(good, rectangles, new_graph):
    graph = new_graph()
    watch(graph, whole_board(rectangles))
    index = board_of(graph)
    node = graph.nodes[index]
    node.normals = {
        keyframe: Rotation.from_rotvec(np.radians(10.0) * np.array([0.0, np.cos(a), np.sin(a)])).apply(node.normal)
        for keyframe, a in enumerate(np.arange(6) * np.pi / 3)
    }
    node.surface.memo.clear()
    bad = assess_quality(graph.nodes, graph.state.structural, graph.config.quality).modes[index]
    assert most_harmed(good, bad) == "normals"
    assert np.delete(np.abs(good - bad), 5).max() < 1e-6
    # All six are 10 deg off their mean: (cos 10 - cos 15) / (1 - cos 15).
    assert bad[5] == pytest.approx(0.554, abs=0.01)


def test_a_plane_that_still_grows_is_stability(rectangles, new_graph):
    """Half of the board five times, then the other half: the same surface afterwards, not yet stable."""
    scene = whole_board(rectangles)
    graph = new_graph()
    for _ in range(5):
        graph.update(scene.shoot((1.0, -0.8, 1.5), AHEAD)[0])
    graph.update(scene.shoot((1.0, 0.8, 1.5), AHEAD)[0])
    grown = graph.state.quality.modes[board_of(graph)]
    graph.update(scene.shoot((1.0, 0.8, 1.5), AHEAD)[0])
    settled = graph.state.quality.modes[board_of(graph)]
    assert most_harmed(settled, grown) == "stability"
    assert grown[6] < 0.01 and settled[6] > 0.99
    assert np.delete(np.abs(settled - grown), 6).max() < 0.01


def test_a_hole_is_interior(good, rectangles, new_graph):
    bad = watch(new_graph(), board_with_window(rectangles))
    assert most_harmed(good, bad) == "interior"
    assert bad[7] == pytest.approx(1 - 0.64 / 3.36, abs=0.03)
    assert np.delete(np.abs(good - bad), 7).max() < 0.03


def test_centres_lie_in_a_cut_window(rectangles, new_graph):
    graph = new_graph()
    watch(graph, board_with_window(rectangles))
    holes = graph.deficiencies
    own = holes.planes == board_of(graph)  # the wall behind has a hole as well: the board's shadow
    centres = holes.centres[own]
    assert len(centres) == 4  # 0.8 m is two tiles of 0.5 m
    assert (np.abs(centres[:, 1]) < 0.4).all() and (np.abs(centres[:, 2] - 1.5) < 0.4).all()
    np.testing.assert_allclose(centres[:, 0], 2.0, atol=1e-3)
    assert holes.areas[own].sum() == pytest.approx(0.64, rel=0.12)
    assert holes.explained[own].all()  # every image showed what lies behind: no view will fill it
    np.testing.assert_allclose(holes.normals[own], np.repeat([[-1.0, 0, 0]], 4, axis=0), atol=1e-3)


def test_explained_holes_can_be_left_out(rectangles, new_graph):
    """The view goes through the window: no view will ever fill it."""
    config = new_graph().config
    graph = PlaneSceneGraph(replace(config, quality=QualityConfig(count_explained_holes=False)))
    modes = watch(graph, board_with_window(rectangles))
    assert modes[7] > 0.98
    assert not (graph.deficiencies.planes == board_of(graph)).any()


@pytest.mark.parametrize("count_explained", [True, False])
def test_centres_lie_in_an_unseen_patch(rectangles, new_graph, count_explained):
    """A post half way hides a strip of a large wall: nothing is known there, so it is a target either way."""
    scene = rectangles().add((2, -3, -0.5), (0, 6, 0), (0, 0, 4)).box((1.0, -0.2, 1.3), (1.1, 0.2, 1.7))
    config = new_graph().config
    quality = QualityConfig(count_explained_holes=count_explained)
    graph = PlaneSceneGraph(replace(config, quality=quality))
    watch(graph, scene)
    own = graph.deficiencies.planes == board_of(graph)
    centres = graph.deficiencies.centres[own]
    assert not graph.deficiencies.explained[own].any()
    # The front of the post spans 0.4 m at 1 m: its shadow on the wall 0.8 m, around (2, 0, 1.5).
    assert len(centres) >= 1
    assert (np.abs(centres[:, 1]) < 0.4).all() and (np.abs(centres[:, 2] - 1.5) < 0.4).all()
    # Seen from the side the strip is filled and the target gone.
    for y in (-1.6, 1.6):
        for _ in range(3):
            graph.update(scene.shoot((0.3, y, 1.5), (2.0, -y, 0.0))[0])
    assert not (graph.deficiencies.planes == board_of(graph)).any()


def test_what_the_map_covers_coarsely_is_deficient_on_any_number_of_threads(rectangles, new_graph, monkeypatch):
    """Fine Gaussians on one half of the board, wide ones on the other."""
    y, z = np.meshgrid(np.arange(-1.175, 1.2, 0.05), np.arange(0.825, 2.2, 0.05))
    means = np.stack([np.full(y.size, 2.0), y.ravel(), z.ravel()], axis=1)
    points = MapPoints(means, np.where(means[:, 1] < 0, 0.02, 0.1))
    frame, results = whole_board(rectangles).shoot(EYE, AHEAD)[0], []
    for threads in (1, 2):
        monkeypatch.setattr(graph_module, "default_threads", lambda count=threads: count)
        graph = new_graph()
        graph.update(frame, map_points=points)
        results.append(graph.deficiencies)
    for name, values in vars(results[0]).items():
        np.testing.assert_array_equal(values, getattr(results[1], name))
    coarse = (results[0].planes == board_of(graph)) & np.isfinite(results[0].sizes)
    assert (results[0].centres[coarse, 1] > 0).all()
    assert results[0].areas[coarse].sum() == pytest.approx(1.2 * 1.4, rel=0.1)
    assert results[0].sizes[coarse].min() > 0.05  # patches at the seam mix both halves
    assert np.median(results[0].sizes[coarse]) == pytest.approx(0.1, rel=1e-6)
    graph.update(frame)
    assert np.isinf(graph.deficiencies.sizes).all()  # without a map there are holes only


@pytest.mark.parametrize("threads", [1, 2])
def test_an_error_beside_the_assessment_reaches_the_caller(rectangles, new_graph, monkeypatch, threads):
    monkeypatch.setattr(graph_module, "default_threads", lambda: threads)
    graph, points = new_graph(), MapPoints(np.zeros((2, 4)), np.zeros(2))
    with pytest.raises(ValueError):
        graph.update(whole_board(rectangles).shoot(EYE, AHEAD)[0], map_points=points)
        graph.deficiencies  # noqa: B018 - where there is one thread they are sought only now


def test_known_space_closes_a_boundary(rectangles, new_graph):
    graph = new_graph()
    watch(graph, whole_board(rectangles), eye=(1.5, 0.0, 1.5))
    config = graph.config.quality
    index = board_of(graph)

    def left_is(state):
        return lambda points: np.where(points[:, 1] > 0, state, 0).astype(np.uint8)

    assert boundary_closure(graph.nodes, config)[index] < 0.05
    for state in (1, 2):  # free, occupied
        half = boundary_closure(graph.nodes, config, left_is(state))[index]
        assert half == pytest.approx(0.5, abs=0.03)
    assert boundary_closure(graph.nodes, config, left_is(0))[index] < 0.05


def test_another_plane_closes_a_boundary(box_room, new_graph):
    """One corner of a room: the sides where walls and floor meet are closed, the rims of the view are open."""
    graph = new_graph()
    graph.update(box_room.shoot((1.0, 1.0, 1.2), (-1.0, -1.0, -0.9))[0])
    assert len(graph.nodes) == 3
    share = boundary_closure(graph.nodes, graph.config.quality)
    assert (share > 0.15).all() and (share < 0.75).all()


def test_normal_consistency_by_hand():
    up, off = np.array([0, 0, 1.0]), np.array([np.sin(np.radians(15)), 0, np.cos(np.radians(15))])
    assert normal_consistency([up, up], 15.0) == pytest.approx(1.0)
    # Mean half way: both 7.5 deg off; (cos 7.5 - cos 15) / (1 - cos 15) = 0.7489
    assert normal_consistency([up, off], 15.0) == pytest.approx(0.7489, abs=1e-3)
    assert normal_consistency([], 15.0) == 0.0
    assert normal_consistency([up, -up], 15.0) == 0.0


def segment(points, area=0.0):
    points = np.asarray(points, dtype=np.float64)
    return PlaneSegment(np.array([0.0, 0, 1]), 0.0, points.mean(axis=0), area, 0.0, len(points), points, 0)


@pytest.mark.parametrize("points", [[[0, 0, 0]], [[0, 0, 0], [1, 0, 0]], [[k / 10, 0, 0] for k in range(9)]])
def test_degenerate_planes_have_defined_scores(points):
    """A point, two points, a line; nothing ever seen of them."""
    node = PlaneNode(0, segment(points), np.eye(3), cell=0.05, window=10)
    quality = assess_quality([node], np.array([False]))
    assert np.isfinite(quality.modes).all() and ((quality.modes >= 0) & (quality.modes <= 1)).all()
    assert 0.0 <= quality.scores[0] <= 1.0
    assert len(find_deficiencies([node])) == 0


def test_no_planes():
    quality = assess_quality([], np.zeros(0, bool))
    assert quality.modes.shape == (0, 8) and quality.scores.shape == (0,)
    assert find_deficiencies([]).centres.shape == (0, 3)


def test_scores_weigh_by_type(rectangles, new_graph):
    graph = new_graph()
    watch(graph, board_with_window(rectangles))
    config = graph.config.quality
    modes = graph.state.quality.modes
    as_wall = assess_quality(graph.nodes, np.ones(len(modes), bool), config).scores
    as_object = assess_quality(graph.nodes, np.zeros(len(modes), bool), config).scores
    np.testing.assert_allclose(as_wall, modes @ np.array(config.weights_structural))  # Eq. 7
    np.testing.assert_allclose(as_object, modes @ np.array(config.weights_object))
    assert as_wall[board_of(graph)] < as_object[board_of(graph)]  # a hole weighs more in a wall


@pytest.mark.parametrize(
    "bad", [{"weights_structural": (1.0,) * 8}, {"weights_object": (1.0,)}, {"fit_scale": 0.0}, {"hole_tile": 0}]
)
def test_bad_configuration_is_refused(bad):
    with pytest.raises(ValueError, match=next(iter(bad))):
        QualityConfig(**bad)


@pytest.mark.parametrize("angle", [0, 10, 27, 45, 60, 83, 90])
@pytest.mark.parametrize("width", [1.5, 2.0, 4.0, 12.0])  # cells
def test_a_strip_that_fills_its_hull_is_covered_wholly(angle, width):
    row, column = np.mgrid[-50:51, -50:51]
    x, y = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    along, across = column * x + row * y, row * x - column * y
    surface = SurfaceGrid(np.zeros(3), np.eye(3), 0.05)
    surface.seen = ((np.abs(along) <= 40) & (np.abs(across) <= width / 2)).astype(np.uint8)
    surface.beside, surface.hits = np.zeros_like(surface.seen), surface.seen.astype(np.int32)
    inside = interior(surface, QualityConfig())
    assert inside.hull_cells > 0 and inside.cells / inside.hull_cells == pytest.approx(1.0, abs=0.02)


def cells_at(corners) -> SurfaceGrid:
    """A grid in which only these cells are seen."""
    surface = SurfaceGrid(np.zeros(3), np.eye(3), 0.05)
    surface.seen = np.zeros((40, 40), np.uint8)
    surface.seen[tuple(np.asarray(corners).T)] = 1
    surface.beside, surface.hits = np.zeros_like(surface.seen), surface.seen.astype(np.int32)
    return surface


def test_cells_of_a_hull_against_asking_every_cell(rng):
    from scipy.spatial import ConvexHull

    points = rng.integers(0, 40, (12, 2))
    cells = np.stack(np.mgrid[0:40, 0:40], axis=-1).reshape(-1, 2)
    alone = QualityConfig(closing_radius=0)
    for corners in (points, np.array([[3, 4], [9, 4], [9, 8], [3, 8]])):
        sides = ConvexHull(corners).equations  # normal, offset: at most 0 inside
        inside = (cells @ sides[:, :2].T + sides[:, 2] <= 1e-9).all(axis=1).sum()
        assert interior(cells_at(corners), alone).hull_cells == inside
    assert interior(cells_at([[5, 5]]), alone).hull_cells == 1
    assert interior(cells_at([[5, 5], [11, 8]]), alone).hull_cells == 4  # (5, 5), (7, 6), (9, 7), (11, 8)


@pytest.mark.parametrize("radius", [0, 1, 3, 4])
def test_closing_and_filling_agree_with_opencv(radius, rng):
    for share in (0.05, 0.3, 0.6, 0.9):
        surface = cells_at(np.argwhere(rng.uniform(size=(40, 40)) < share))
        pad = radius + 1
        padded = cv2.copyMakeBorder(surface.seen, pad, pad, pad, pad, cv2.BORDER_CONSTANT, value=0)
        closed = cv2.morphologyEx(padded, cv2.MORPH_CLOSE, disc(radius))
        outlines, _ = cv2.findContours(closed, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        filled = np.zeros_like(padded)
        cv2.drawContours(filled, outlines, -1, 1, thickness=cv2.FILLED)
        inside = interior(surface, QualityConfig(closing_radius=radius))
        np.testing.assert_array_equal(inside.mask, filled[pad:-pad, pad:-pad])
        assert inside.cells == filled.sum()
