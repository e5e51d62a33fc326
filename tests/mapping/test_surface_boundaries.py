"""Where surfaces end in a frame, worked by hand, and the disks beside such borders."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.mapping.seeding import pixel_samples, seed_disks
from activestructure_gym.mapping.surface_boundaries import nearest_boundaries
from activestructure_gym.mapping.surface_links import surface_links

CAMERA = PinholeCamera.from_size(40, 30)  # f = 20, so a pixel at 2 m is 10 cm wide
FAR = 100.0  # metres to look


def scene(depth: np.ndarray) -> Frame:
    depth = np.ascontiguousarray(depth, np.float32)
    return Frame(np.full((*depth.shape, 3), 90, np.uint8), depth, np.eye(4), CAMERA)


def at(row: int, column: int) -> np.ndarray:
    return np.array([row * CAMERA.width + column])


def border(frame: Frame, row: int, column: int, reach: float = FAR) -> tuple[float, list[float]]:
    found = nearest_boundaries(frame, surface_links(frame.depth), at(row, column), np.array([reach]))
    return float(found.distance[0]), found.direction[0].tolist()


def box_before_wall() -> Frame:
    """Columns 10 to 29 at 2 m, before a wall at 4 m."""
    depth = np.full((30, 40), 4.0)
    depth[:, 10:30] = 2.0
    return scene(depth)


def test_the_nearer_surface_ends_at_a_step_and_the_farther_one_goes_on() -> None:
    frame = box_before_wall()
    assert border(frame, 15, 10) == (0.5, [-1.0, 0.0])  # half a pixel from its middle to its own left border
    assert border(frame, 15, 26) == (3.5, [1.0, 0.0])
    distance, direction = border(frame, 15, 9)  # of the wall behind
    assert np.isinf(distance) and direction == [0.0, 0.0]


def test_no_border_at_the_image_s_end_and_none_beyond_the_reach() -> None:
    assert np.isinf(border(scene(np.full((30, 40), 2.0)), 0, 0)[0])
    # Four pixels of 10 cm: seen from 35 cm on, as the next pixel is looked at to the end.
    assert border(box_before_wall(), 15, 26, 0.35)[0] == 3.5
    assert np.isinf(border(box_before_wall(), 15, 26, 0.2)[0])


def test_no_return_is_a_border() -> None:
    depth = np.full((30, 40), 2.0)
    depth[:12] = 0.0
    assert border(scene(depth), 12, 20) == (0.5, [0.0, -1.0])


def test_a_slanted_border_is_as_far_as_the_line_through_both_axes() -> None:
    rows, columns = np.mgrid[:30, :40]
    frame = scene(np.where(rows + columns < 40, 2.0, 4.0))
    distance, direction = border(frame, 15, 20)  # four more pixels along the row and along the column
    assert distance == pytest.approx(4.5 / np.sqrt(2)) and direction == pytest.approx([np.sqrt(0.5)] * 2)


def test_a_plane_has_no_border_and_a_convex_edge_is_one() -> None:
    x = np.broadcast_to((np.arange(40) + 0.5 - CAMERA.cx) / CAMERA.fx, (30, 40))
    floor = 2.0 / (1.0 + 0.3 * x)  # a plane
    assert all(np.isinf(border(scene(floor), 15, column)[0]) for column in (0, 7, 39))
    # Two planes that meet in column 20: nearest there (convex), or farthest (a room's corner).
    convex, concave = 2.0 / (1.0 - 0.5 * np.abs(x)), 2.0 / (1.0 + 0.5 * np.abs(x))
    assert border(scene(convex), 15, 22)[1] == [-1.0, 0.0]
    assert np.isinf(border(scene(concave), 15, 22)[0])


def axes_and_sigmas(block: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return Rotation.from_quat(block[3:7].T, scalar_first=True).as_matrix()[0], np.exp(block[7:10, 0])


def test_a_disk_is_narrow_towards_the_border_and_wide_along_it() -> None:
    frame = box_before_wall()
    row, column = np.array([15]), np.array([10])
    block = seed_disks(frame, pixel_samples(frame, row, column), np.array([0.2]), thickness=0.1, border_sigmas=1.0)
    axes, sigmas = axes_and_sigmas(block)
    assert sigmas == pytest.approx([0.05, 0.2, 0.02])  # half a pixel of 10 cm
    assert np.abs(axes[:, 0]) == pytest.approx([1, 0, 0], abs=1e-6) and abs(axes[2, 2]) == pytest.approx(1)
    two = seed_disks(frame, pixel_samples(frame, row, column), np.array([0.2]), thickness=0.1, border_sigmas=2.0)
    assert axes_and_sigmas(two)[1] == pytest.approx([0.025, 0.2, 0.02])
    off = seed_disks(frame, pixel_samples(frame, row, column), np.array([0.2]), thickness=0.1)
    assert axes_and_sigmas(off)[1] == pytest.approx([0.2, 0.2, 0.02])


@pytest.mark.parametrize("slope", [0.0, 0.4, -0.5])
@pytest.mark.parametrize("turn", [0.0, 0.6, 2.0])
def test_on_a_slanted_surface_the_distance_is_metric(slope: float, turn: float) -> None:
    """The point one narrow sigma from the mean, towards the border, projects onto the border."""
    rows, columns = np.mgrid[:30, :40] + 0.5
    x, y = (columns - CAMERA.cx) / CAMERA.fx, (rows - CAMERA.cy) / CAMERA.fy
    inside = np.cos(turn) * (columns - 20) + np.sin(turn) * (rows - 15) < 3.0
    frame = scene(np.where(inside, 2.0 / (1.0 + slope * x + 0.2 * y), 40.0))
    row, column = np.array([15]), np.array([20])
    seeds, sigma = pixel_samples(frame, row, column), np.array([5.0])
    block = seed_disks(frame, seeds, sigma, thickness=1e-3, border_sigmas=1.0)
    axes, sigmas = axes_and_sigmas(block)
    ends = block[:3, 0] + np.outer([-sigmas[0], sigmas[0]], axes[:, 0])
    found = nearest_boundaries(frame, surface_links(frame.depth), seeds.pixels, sigma)
    pixels = ends[:, :2] / ends[:, 2:] * CAMERA.fx + [CAMERA.cx, CAMERA.cy] - [20.5, 15.5]
    # To first order in the step, which on a slanted surface is not all of it.
    assert np.abs(pixels @ found.direction[0]).mean() == pytest.approx(found.distance[0], rel=0.1)
    # Along the border the distance to it stays as it is.
    aside = block[:3, 0] + 1e-3 * axes[:, 1]
    moved = aside[:2] / aside[2] * CAMERA.fx + [CAMERA.cx, CAMERA.cy] - [20.5, 15.5]
    assert abs(moved @ found.direction[0]) < 1e-5
