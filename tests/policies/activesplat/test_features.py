"""ActiveSplat's columns on a hand-made floor: which nodes are worth going to, and what a view shows of gaps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from activestructure_gym.features import FeatureContext, evaluate_features
from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.motion import VoronoiGraph
from activestructure_gym.policies.activesplat import features
from activestructure_gym.policies.activesplat.features import MIN_VIEW_DEG2, regions
from activestructure_gym.sensors import Frame
from activestructure_gym.views import panorama
from activestructure_gym.volume import FREE, VoxelVolume

CAMERA = PinholeCamera.from_size(40, 24)
NAMES = tuple(f"activesplat_{name}" for name in ("information", "volume", "region", "view", "x", "y"))
START = np.array([2.0, 2.0, 1.25])
LEFT, RIGHT = np.array([2.0, 2.0, 1.25]), np.array([4.0, 2.0, 1.25])  # the two nodes of a room of 6 x 4 m


@pytest.fixture(autouse=True)
def _analytic_depth(monkeypatch: pytest.MonkeyPatch) -> None:
    """The map of `context` is a function that returns depth and opacity of every pixel."""

    def median(gaussians: Callable, camera: PinholeCamera, poses: np.ndarray) -> np.ndarray:
        depth, alpha = gaussians(camera, poses)
        return np.where(alpha > 0.5, depth, 0.0)

    monkeypatch.setattr(features, "median_depths", median)


def frame(place: np.ndarray, yaw: float) -> Frame:
    pose = look_along(place, np.array([np.cos(yaw), np.sin(yaw), 0.0]))
    size = (CAMERA.height, CAMERA.width)
    return Frame(np.zeros((*size, 3), np.uint8), np.ones(size, np.float32), pose, CAMERA)


def context(
    is_open: Callable[[np.ndarray], np.ndarray],  # [..., 3] unit directions, world -> [...] bool
    places: tuple[np.ndarray, ...] = (LEFT, RIGHT, np.array([3.0, 0.5, 1.25])),
    east: tuple[float, float] = (3.0, 1.0),  # metres, opacity of the surface to the east
) -> FeatureContext:
    """A map without surface in some directions; it is opaque and two metres away to the west."""

    def surface(camera: PinholeCamera, poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        rays = camera.rays() / np.linalg.norm(camera.rays(), axis=-1, keepdims=True)
        directions = np.einsum("kij,hwj->khwi", poses[:, :3, :3], rays)
        depth, alpha = (np.where(directions[..., 0] > 0, *two).astype(np.float32) for two in zip(east, (2.0, 1.0)))
        return depth, np.where(is_open(directions), np.float32(0.0), alpha)

    def render(camera: PinholeCamera, poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        depth, alpha = surface(camera, poses)
        return alpha * depth, alpha

    volume = VoxelVolume(np.array([[0.0, 0.0, 0.0], [6.0, 4.0, 2.5]]))
    volume.state[1:-1, 1:-1, 1:-1] = FREE
    return FeatureContext(
        mapper=SimpleNamespace(map=surface, render_depth_alpha=render, keyframes=[frame(START, 0.0)]),
        volume=volume, planes=None, camera=CAMERA, bounds=np.zeros((2, 3)), coverage_alpha=0.5,
        max_range=10.0,
        world_from_camera=np.stack([look_along(p, np.array([0.0, 1.0, 0.0])) for p in places]),
    )  # fmt: skip


def north(directions: np.ndarray) -> np.ndarray:
    return (directions[..., 1] > 0.9) & (np.abs(directions[..., 2]) < 0.5)


def test_nodes_with_an_opening_count_and_views_without_a_node_do_not() -> None:
    information, volume, region, view, x, y = evaluate_features(NAMES, context(north)).T
    np.testing.assert_allclose([x[2], y[2]], [3.0, 0.5])  # no node: its own place
    assert information[0] == pytest.approx(information[1])  # the same panorama
    assert volume[0] > 0.1  # the outline lies at two depths
    rays = panorama.camera().rays() / np.linalg.norm(panorama.camera().rays(), axis=-1, keepdims=True)
    turned = np.einsum("kij,hwj->khwi", panorama.poses(LEFT[None])[:, :3, :3], rays)
    assert information[0] / volume[0] == pytest.approx(north(turned).sum() * panorama.DEG_PER_PIXEL**2, rel=1e-5)
    assert (information[2], volume[2], region[2]) == (0.0, 0.0, -1.0)
    assert region[0] == region[1] == 1.0  # 2 m apart
    np.testing.assert_allclose(view, view[0])


def test_a_covered_map_leaves_nothing() -> None:
    closed = evaluate_features(NAMES, context(lambda d: np.zeros(d.shape[:-1], bool)))
    assert not closed[:, [0, 1, 3]].any()


def test_pathology_what_lies_above_or_below_the_panorama_is_ignored() -> None:
    """The panorama ends 75 degrees above and below the horizon: the ceiling overhead may stay open for ever."""
    steep = evaluate_features(NAMES, context(lambda d: np.abs(d[..., 2]) > np.sin(np.radians(76.0))))
    assert not steep[:, :2].any()
    within = evaluate_features(NAMES, context(lambda d: np.abs(d[..., 2]) > np.sin(np.radians(60.0))))
    assert within[0, 0] > 0


def test_surface_counts_at_its_median_depth_and_not_where_more_than_half_is_missing() -> None:
    """The outline of the gap to the north is half to the west, half to the east."""

    def volume(metres: float, alpha: float) -> float:
        return float(evaluate_features(NAMES, context(north, east=(metres, alpha)))[0, 1])

    step = volume(4.0, 1.0)
    assert step > 0.1
    assert volume(4.0, 0.5001) == pytest.approx(step)  # accumulated, both would be at 2 m
    assert volume(2.0, 0.3) == 0.0  # accumulated, the eastern half would be at 0.6 m


def test_a_node_with_little_room_to_either_side_counts() -> None:
    narrow = context(north)
    narrow.volume.state[:, 24:] = 0
    narrow.volume.state[:, :18] = 0  # a corridor 0.6 m wide: 0.3 m to either side
    # The only node of a corridor is somewhere in its middle.
    places = np.stack([look_along(np.array([x, 2.1, 1.25]), START) for x in np.arange(0.5, 6.0, 0.5)])
    columns = evaluate_features(("voronoi_node", *NAMES), replace(narrow, world_from_camera=places))
    at_node = columns[:, 0] >= 0
    assert at_node.any() and (columns[at_node, 1] > 0).all()
    assert np.abs(columns[at_node, 5] - places[at_node, 0, 3]).max() <= 0.5
    assert np.ptp(columns[at_node, 5]) == 0.0  # the position of the node


def test_subregions_by_hand() -> None:
    def graph(x: list[float], edges: list[tuple[int, int]], lengths: list[float]) -> VoronoiGraph:
        at = np.column_stack([x, np.zeros(len(x))])
        return VoronoiGraph(at, np.ones(len(x)), np.array(edges).reshape(-1, 2), np.array(lengths), np.zeros((0, 2)),
                            np.zeros(0, np.int64))  # fmt: skip

    one, two, three, four = regions(graph([0.0, 1.0, 5.0, 6.0], [(0, 1), (1, 2), (2, 3)], [1.0, 4.0, 1.0]))
    assert one == two != three == four
    # 1 m apart through a wall and 5 m of way: 0.5 x 5 + 0.5 x 1 = 3 m.
    assert len(set(regions(graph([0.0, 1.0], [(0, 1)], [5.0])))) == 2
    assert len(set(regions(graph([0.0, 1.0], [(0, 1)], [2.9])))) == 1
    assert len(set(regions(graph([0.0, 1.0], [], [])))) == 2
    assert regions(graph([0.0], [], [])).tolist() == [1]


def test_a_view_counts_gaps_in_square_degrees_and_no_small_ones() -> None:
    def show(half: float, above: float = -1.0) -> float:
        cone = np.cos(np.radians(half))
        return float(evaluate_features(NAMES, context(lambda d: (d[..., 1] > cone) & (d[..., 2] > above)))[0, 3])

    # A cone of 20 degrees around the axis holds 2 pi (1 - cos 20) steradian = 1243 square degrees.
    assert show(20.0) == pytest.approx(2 * np.pi * (1 - np.cos(np.radians(20.0))) * np.degrees(1) ** 2, rel=0.03)
    # In the middle of this image a pixel is 2.9 degrees wide: 16 of them are a gap, the eight above the axis are not.
    assert show(7.0) == pytest.approx(16 * np.degrees(1 / 20.0) ** 2, rel=0.02)
    assert 0.5 * show(7.0) < MIN_VIEW_DEG2 < show(7.0)
    assert show(7.0, above=0.0) == 0.0
