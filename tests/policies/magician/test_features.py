"""MAGICIAN: the search against all plans, its plan where greed is wrong, and what is imagined of a wall."""

from __future__ import annotations

from itertools import permutations
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from activestructure_gym.features import evaluate_features
from activestructure_gym.geometry import PinholeCamera, invert_rigid, look_along, transform_points
from activestructure_gym.planes.surface import Patch, SurfaceGrid
from activestructure_gym.policies.magician.features import (
    CAP,
    Costs,
    continuation,
    imagined,
    ray_image,
    search,
    visible_cells,
)
from activestructure_gym.volume import FREE, UNKNOWN, VoxelVolume


def by_all_plans(sights: np.ndarray, costs: Costs, steps: int, frames: float) -> np.ndarray:
    """The best worth of any plan, by its first view."""
    best = np.zeros(len(sights))
    for length in range(1, steps + 1):
        for plan in permutations(range(len(sights)), length):
            cost = costs.first[plan[0]] + sum(costs.between[a, b] for a, b in zip(plan, plan[1:]))
            if cost <= frames:
                best[plan[0]] = max(best[plan[0]], sights[list(plan)].any(axis=0).sum())
    return best


def test_with_enough_beams_it_is_the_best_of_all_plans(rng: np.random.Generator) -> None:
    for _ in range(5):
        sights = rng.random((5, 30)) < 0.3
        between = rng.integers(1, 9, (5, 5)).astype(float)
        costs = Costs(rng.integers(1, 9, 5).astype(float), between)
        found = search(sights, costs, beams=10_000, steps=4, frames=14.0)
        assert np.array_equal(np.ceil(found), by_all_plans(sights, costs, 4, 14.0))
        few = search(sights, costs, beams=2, steps=4, frames=14.0)
        assert (few <= found).all() and np.ceil(few.max()) >= sights[costs.first <= 14.0].sum(axis=1).max()


def test_a_plan_of_two_near_views_beats_the_best_single_one() -> None:
    # View 0 sees 5 cells and is far from everything; 1 and 2 see 4 each, and stand together.
    sights = np.zeros((3, 13), bool)
    sights[0, :5], sights[1, 5:9], sights[2, 9:] = True, True, True
    between = np.array([[1.0, 30, 30], [30, 1, 2], [30, 2, 1]])
    costs = Costs(np.array([20.0, 5, 6]), between)

    def cells(*arguments) -> list:
        return np.ceil(search(*arguments)).tolist()

    assert cells(sights, costs, 10, 10, 20.0) == [5, 8, 8]
    assert search(sights, costs, 10, 10, 20.0).argmax() == 1  # 7 frames for both, against 8
    assert cells(sights, costs, 1, 1, 20.0) == [5, 4, 4]  # greedy
    assert cells(sights, costs, 10, 10, 60.0) == [13, 13, 13]  # time enough for all ...
    assert search(sights, costs, 10, 10, 60.0).argmax() == 1  # ... the near ones first
    assert cells(sights, costs, 10, 10, 4.0) == [0, 0, 0]
    assert cells(np.zeros((3, 0), bool), costs, 10, 10, 20.0) == [0, 0, 0]


def test_what_one_view_saw_is_no_news_to_the_next() -> None:
    sights = np.zeros((2, 6), bool)
    sights[0, :4], sights[1, 2:] = True, True
    costs = Costs(np.ones(2), np.ones((2, 2)))
    assert np.ceil(search(sights, costs, 10, 10, 9.0)).tolist() == [6, 6]


def wall() -> SimpleNamespace:
    """A patch of 1 m x 1 m, seen, of the wall x = 2 around its middle."""
    grid = SurfaceGrid(np.array([2.0, 0.0, 0.0]), np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]]), 0.05)
    shown = np.ones((20, 20), np.int32)
    none = np.zeros_like(shown)
    grid.add(Patch(np.array([-10, -10]), shown, none, shown, none.astype(np.uint8)))
    return SimpleNamespace(surface=grid)


def test_a_wall_goes_on_through_the_unseen_and_ends_at_what_is_known(two_walls) -> None:
    node, volume = wall(), two_walls.volume
    all_wanted = np.ones(volume.shape, bool)
    cells = continuation(node, volume, all_wanted)
    assert cells[:, 0] == pytest.approx(2.0)
    beyond = np.maximum(np.abs(cells[:, 1:]).max(axis=1) - 0.5, 0.0)
    assert 0.0 < beyond.min() and CAP - 0.05 < beyond.max() <= CAP
    assert len(cells) == pytest.approx((4 * 1.0 * CAP + np.pi * CAP**2) / 0.05**2, rel=0.05)
    # Known on the left, and a known strip on the right: nothing is imagined behind it.
    known = all_wanted.copy()
    y = volume.origin[1] + (np.arange(volume.shape[1]) + 0.5) * volume.config.voxel_size
    known[:, (y < 0) | ((y > 0.75) & (y < 0.95))] = False
    cells = continuation(node, volume, known)
    assert (cells[:, 1] > -0.01).all() and (cells[np.abs(cells[:, 2]) < 0.5, 1] < 0.8).all() and len(cells) > 100
    assert len(continuation(node, volume, ~all_wanted)) == 0


@pytest.mark.parametrize("width", [40, 80])
@pytest.mark.parametrize("distance", [2.0, 3.0, 4.0])
def test_no_voxel_of_a_far_wall_is_left_for_a_view_beside(width: int, distance: float) -> None:
    volume = VoxelVolume(np.array([[0.0, -6.0, -6.0], [6.0, 6.0, 6.0]]))
    wall = np.zeros(volume.shape, bool)
    wall[volume.voxel_of(np.array([distance + 1.0, 0.0, 0.0]))[0]] = True
    eyes = np.array([[1.0, 0.0, 0.0], [1.0, 0.25, 0.0]])
    camera = PinholeCamera.from_size(width, width * 9 // 16, 90.0)
    context: Any = SimpleNamespace(
        volume=volume, camera=camera, max_range=10.0,
        world_from_camera=np.stack([look_along(eye, np.array([1.0, 0.0, 0.0])) for eye in eyes]),
    )  # fmt: skip
    first, second = visible_cells(context, wall)
    centres = volume.center_of(np.argwhere(wall))
    in_image = [camera.in_image(transform_points(invert_rigid(pose), centres)) for pose in context.world_from_camera]
    assert first.sum() == pytest.approx(in_image[0].sum(), rel=0.06)
    assert (second & ~first).sum() <= (in_image[1] & ~in_image[0]).sum() + 0.03 * in_image[0].sum()


@pytest.mark.parametrize(("degrees", "width"), [(90.0, 100), (120.0, 174), (170.0, 200)])
def test_the_number_of_rays_has_a_limit_in_very_wide_images(degrees: float, width: int) -> None:
    image = ray_image(PinholeCamera.from_size(64, 36, degrees), 50.0)
    assert image.width == width and image.width / image.fx == pytest.approx(2 * np.tan(np.radians(degrees / 2)))


def test_views_see_what_is_imagined_and_not_what_hides_behind_it(two_walls) -> None:
    two_walls.know(UNKNOWN)
    volume = two_walls.volume
    middles = [volume.origin[i] + (np.arange(volume.shape[i]) + 0.5) * volume.config.voxel_size for i in range(3)]
    inside = np.ix_(*[np.abs(m) < 1.85 for m in middles])
    volume.state[inside] = FREE
    volume.weight[inside] = 1
    planes = SimpleNamespace(nodes=[wall()])
    east, west = (look_along(np.zeros(3), np.array(axis, float)) for axis in ([1, 0, 0], [-1, 0, 0]))
    behind = look_along(np.array([2.6, 0.0, 0.0]), np.array([1.0, 0.0, 0.0]))
    context = two_walls.context(east, west, behind, planes=planes)
    assert imagined(context).sum() > 50
    table = evaluate_features(("magician",), context)
    assert table[0, 1] > 0.5 and table[1, 1] == table[2, 1] == 0.0
    assert np.array_equal(table[:, 0], table[:, 1])  # nobody walks: no plan
    again = context.volume.unobserved
    assert again[imagined(context)].all()
