"""GS-Planner's gains on hand-made space: volumes of frustums, transmittance, and the loss that a voxel keeps."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from activestructure_gym.features import FeatureContext, evaluate_features
from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.policies.gs_planner.features import (
    COLOUR_WEIGHT,
    LOSS_KEYFRAMES,
    STRIDE,
    pixel_losses,
    spread,
    voxel_losses,
)
from activestructure_gym.sensors import Frame
from activestructure_gym.volume import FREE, OCCUPIED, UNKNOWN, VolumeConfig, VoxelVolume

CAMERA = PinholeCamera.from_size(16, 8, 20.0)
NAMES = ("gs_planner_volume", "gs_planner_loss")


def space() -> VoxelVolume:
    """6 m along the camera's z, all free; the camera stands at the origin, in the middle of one end."""
    volume = VoxelVolume(np.array([[-2.0, -2.0, 0.0], [2.0, 2.0, 6.0]]), VolumeConfig())
    volume.state[:] = FREE
    return volume


def slab(volume: VoxelVolume, near: float, far: float, state: int) -> None:
    z = volume.center_of(np.stack([np.zeros(volume.shape[2])] * 2 + [np.arange(volume.shape[2])], axis=1))[:, 2]
    volume.state[:, :, (z > near) & (z < far)] = state


def context(volume: VoxelVolume, depth: float, alpha: float, mapper: Any = None) -> FeatureContext:
    image = np.full((1, CAMERA.height, CAMERA.width), alpha, np.float32)
    frames = SimpleNamespace(keyframes=[]) if mapper is None else mapper
    frames.render_depth_alpha = lambda camera, poses: (image * np.float32(depth), image)
    return FeatureContext(
        mapper=frames, volume=volume, planes=None, camera=CAMERA, bounds=np.zeros((2, 3)), coverage_alpha=0.5,
        max_range=10.0, world_from_camera=np.eye(4)[None],
    )  # fmt: skip


def frustum(near: float, far: float) -> float:
    """The paper's volume between two depths, of one pixel with f = 1."""
    inner, outer = near**2, far**2
    return (far - near) * (inner + np.sqrt(inner * outer) + outer) / 3.0


def test_volumes_against_the_formula_and_the_transmittance_before_them() -> None:
    volume = space()
    slab(volume, 1.0, 2.0, UNKNOWN)
    slab(volume, 3.0, 4.0, UNKNOWN)
    whole = frustum(0.0, 5.0)
    open_way = evaluate_features(NAMES, context(volume, 0.0, 0.0))[0]
    assert open_way[0] == pytest.approx((frustum(1.0, 2.0) + frustum(3.0, 4.0)) / whole, rel=0.04)
    assert open_way[1] == 0.0
    # A veil at 2.5 m hides three quarters of the second interval, a wall there all of it.
    veiled = evaluate_features(NAMES, context(volume, 2.5, 0.75))[0]
    assert veiled[0] == pytest.approx((frustum(1.0, 2.0) + 0.25 * frustum(3.0, 4.0)) / whole, rel=0.04)
    walled = evaluate_features(NAMES, context(volume, 2.5, 1.0))[0]
    assert walled[0] == pytest.approx(frustum(1.0, 2.0) / whole, rel=0.04)


def test_the_unknown_all_over_is_the_whole_and_the_free_is_nothing() -> None:
    volume = space()
    assert evaluate_features(NAMES, context(volume, 0.0, 0.0))[0, 0] == 0.0
    volume.state[:] = UNKNOWN
    assert evaluate_features(NAMES, context(volume, 0.0, 0.0))[0, 0] == pytest.approx(1.0, rel=1e-3)


def test_pathology_a_hole_in_the_map_shows_what_lies_behind_a_known_wall() -> None:
    """The walk asks the map for what hides; where the map lacks a wall, the unknown behind it counts."""
    volume = space()
    slab(volume, 2.0, 2.2, OCCUPIED)
    slab(volume, 2.2, 6.1, UNKNOWN)
    assert evaluate_features(NAMES, context(volume, 0.0, 0.0))[0, 0] > 0.9
    assert evaluate_features(NAMES, context(volume, 2.1, 1.0))[0, 0] == 0.0


def test_the_loss_by_hand_and_in_the_first_occupied_voxel() -> None:
    depth = np.full((CAMERA.height, CAMERA.width), 2.05, np.float32)
    depth[0] = 0.0  # no return
    frame = Frame(np.full((*depth.shape, 3), 51, np.uint8), depth, np.eye(4), CAMERA)  # 0.2 of full brightness
    # The map is a little transparent: what it shows lies at 1.95 m, its weighted sum is less.
    shown = SimpleNamespace(
        color=np.full((*depth.shape, 3), 0.5, np.float32), depth=np.full_like(depth, 0.9 * 1.95),
        alpha=np.full_like(depth, 0.9),
    )  # fmt: skip
    expected = 0.1 + COLOUR_WEIGHT * 0.3
    points, loss = pixel_losses(frame, shown.color, shown.depth / shown.alpha)
    assert len(loss) == (CAMERA.height - 1) * CAMERA.width
    np.testing.assert_allclose(loss, expected, rtol=1e-5)
    np.testing.assert_allclose(points[:, 2], 2.05, rtol=1e-6)

    volume = space()
    slab(volume, 2.0, 2.1, OCCUPIED)
    slab(volume, 4.0, 4.1, OCCUPIED)
    mapper = SimpleNamespace(keyframes=[frame], render=lambda camera, pose: shown)
    step = context(volume, 1.95, 1.0, mapper)
    table = voxel_losses(step)
    np.testing.assert_allclose(table[table > 0], expected, rtol=1e-5)
    assert (volume.state[table > 0] == OCCUPIED).all()
    rows = CAMERA.height // STRIDE
    # The rays of the row without a return meet voxels of which nothing is known, or those that others measured.
    assert (rows - 1) / rows * expected <= evaluate_features(NAMES, step)[0, 1] * (1 + 1e-6) <= expected * (1 + 1e-5)


def test_keyframes_with_the_loss_are_the_newest_and_some_of_all_others() -> None:
    assert spread(0, LOSS_KEYFRAMES) == []
    assert spread(5, 16) == [0, 1, 2, 3, 4]
    assert spread(16, 16) == list(range(16))
    assert spread(100, 8) == [0, 32, 63, 95, 96, 97, 98, 99]


def test_the_shell_in_front_of_a_wall_that_was_seen_holds_nothing_unseen(two_walls, looks) -> None:
    east, _, north = evaluate_features(("gs_planner_volume",), two_walls.context(*looks))[:, 0]
    assert (two_walls.volume.state == UNKNOWN).any()
    assert east < 0.02 < 0.2 < north
