"""Where seeds go on far surfaces, on which neighbouring pixels are up to 2 m apart."""

from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.geometry.frame import Frame
from tests.mapping.surfaces import SPACING, all_samples, dense, farthest, linked, mapped, picture, plane


@pytest.mark.parametrize("slope", [-0.75, -0.7, -0.6])
def test_every_point_of_a_slanted_floor_has_a_mean_near_as_far_as_gaps_are_filled(slope: float) -> None:
    """Rows are up to 1.3 to 14 m apart on the floor; those further apart than 2 m are not joined."""
    floor = picture([plane([0, 0, -1.2], [0, 0, 1])], direction=[1.0, 0.0, slope])
    points = floor.camera.backproject(floor.depth)
    down = np.linalg.norm(np.diff(points, axis=0), axis=2)  # [44, 80]
    cells = (np.maximum(down[:, 1:], down[:, :-1]) < 2.0) & (floor.depth > 0)[:-1, :-1] & (floor.depth > 0)[1:, 1:]
    inside = np.repeat(np.repeat(cells, 8, axis=0), 8, axis=1).ravel()
    mapper = mapped(floor)
    samples = all_samples(floor, np.full(floor.depth.shape, SPACING, np.float32))
    pose = floor.world_from_camera
    assert farthest(samples.points @ pose[:3, :3].T + pose[:3, 3], mapper).max() < SPACING + 1e-5
    distance = farthest(dense(floor), mapper)
    assert inside.mean() > 0.9 and down.max() > 1.0
    # Where the number of parts changes from row to row, samples that are spared may be neighbours.
    assert (distance[inside] > 1.01 * SPACING).mean() < 0.005 and distance[inside].max() < 1.5 * SPACING


def test_a_corridor_of_12_m_is_mapped_as_far_as_the_sensor_reaches() -> None:
    """Rows of floor and ceiling are up to 1 m apart, columns of the walls up to 0.8 m."""
    camera = PinholeCamera.from_size(160, 90)
    sides = [plane([0, 0, -1.3], [0, 0, 1]), plane([0, 0, 1.2], [0, 0, 1]), plane([0, -0.9, 0], [0, 1, 0])]
    sides += [plane([0, 0.9, 0], [0, 1, 0]), plane([12, 0, 0], [1, 0, 0])]
    frame = picture(sides, camera=camera)
    frame.depth[frame.depth > 10.0] = 0.0
    mapper = mapped(frame)
    along = np.linspace(2.4, 8.9, 600)
    for y, z in ((0.0, -1.3), (0.5, -1.3), (0.0, 1.2), (0.9, 0.0), (-0.9, 0.6)):
        distance = farthest(np.stack([along, np.full(600, y), np.full(600, z)], axis=1), mapper)
        assert distance.max() < 2 * SPACING
    off = np.abs(mapper.map.means[:, 1:] - [0.0, -0.05]) - [0.9, 1.25]
    assert np.abs(off.max(axis=1)).max() < 0.01  # on a side, not within the corridor


def test_nothing_stands_between_a_far_table_and_the_floor_behind_it() -> None:
    """Rows of the floor behind the edge are 0.6 to 1.4 m apart, and the step to the floor is 1.2 to 2 m."""
    camera = PinholeCamera.from_size(160, 90)
    floor = plane([0, 0, -1.3], [0, 0, 1])
    for end in np.linspace(4.0, 7.0, 13):
        for height in (-0.9, -0.6, -0.3):
            top = plane([0, 0, height], [0, 0, 1], lambda p, end=end: (p[:, 0] > end - 2.0) & (p[:, 0] < end))
            mapper = mapped(picture([top, floor], camera=camera))
            means = mapper.map.means[mapper.map.means[:, 0] < 10.0]
            on_floor, on_top = np.abs(means[:, 2] + 1.3) < 0.03, np.abs(means[:, 2] - height) < 0.03
            assert (on_floor | on_top).all() and on_top.any()


def test_a_cell_is_filled_only_if_all_four_edges_are() -> None:
    """Pixels are 0.3 m apart. Only the lower edge of the cell at (10, 10), 0.63 m long, is not proven one surface."""
    depth = np.full((24, 24), 30.0, np.float32)
    depth[11:, 11:] = 30.55
    depth[11, 12:] = 30.1
    camera = PinholeCamera(24, 24, 100.0, 100.0, 12.0, 12.0)
    frame = Frame(np.zeros((24, 24, 3), np.uint8), depth, np.eye(4), camera)
    assert linked(depth, 11, 10, down=False)
    samples = all_samples(frame, np.full(depth.shape, 0.1, np.float32))
    cell = samples.points[samples.pixels == 10 * 24 + 10]
    assert len(cell) > 4 and cell[:, 2] == pytest.approx(30.0, abs=1e-4)  # on the upper and the left edge
