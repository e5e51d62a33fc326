"""What lies well behind a measured surface takes no part in that keyframe, and nothing else is left out."""

import numpy as np
import pytest

from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.mapping import GaussianMap
from activestructure_gym.mapping.boxes import BLOCK
from activestructure_gym.mapping.frustum_culling import MapParts
from activestructure_gym.mapping.occlusion_culling import MARGIN, behind_the_measured, depth_tiles

CAMERA = PinholeCamera(64, 48, 40.0, 40.0, 32.0, 24.0)
POSE = look_along(np.zeros(3), np.array([1.0, 0.0, 0.0]))  # along +x
WALL = np.full((48, 64), 2.0, np.float32)


def _box(centre, half, sigma=0.01):
    return np.concatenate([np.subtract(centre, half), np.add(centre, half), [sigma]])[None]


def _hidden(box, depth=WALL):
    return bool(behind_the_measured(box, depth_tiles(depth, CAMERA, POSE))[0])


@pytest.mark.parametrize(
    ("nearest", "hidden"), [(1.0, False), (2.0, False), (2.0 + MARGIN - 0.01, False), (2.0 + MARGIN + 0.01, True)]
)
def test_a_box_hides_a_margin_behind_the_wall(nearest, hidden):
    sigma = 0.001
    assert _hidden(_box((nearest + 0.3 + 3.35 * sigma, 0, 0), 0.3, sigma)) is hidden


def test_wide_gaussians_reach_out_of_the_box_of_their_means():
    assert _hidden(_box((3.0, 0, 0), 0.1, 0.1)) and not _hidden(_box((3.0, 0, 0), 0.1, 0.13))


def test_one_pixel_without_return_on_the_way_shows_what_is_behind():
    box = _box((4.0, 0, 0), 0.2)
    for row, column, hidden in ((24, 32, False), (2, 2, True)):
        depth = WALL.copy()
        depth[row, column] = 0.0
        assert _hidden(box, depth) is hidden
        depth[row, column] = 6.0  # through a door
        assert _hidden(box, depth) is hidden


def test_behind_the_camera_and_around_it_nothing_is_said_to_be_hidden():
    assert not _hidden(_box((-3.0, 0, 0), 0.2)) and not _hidden(_box((3.0, 0, 0), 4.0))


def test_random_boxes_that_hide_hold_no_point_before_the_wall():
    """Oracle: every point of a hidden box that falls into the image is further than the pixel it falls on."""
    rng = np.random.default_rng(0)
    depth = np.where(rng.uniform(size=(6, 8)) < 0.2, 0.0, rng.uniform(1, 4, (6, 8))).repeat(8, 0).repeat(8, 1)
    depth = np.roll(depth, (3, 5), (0, 1)).astype(np.float32)
    boxes = np.concatenate([_box(rng.uniform((0, -3, -3), (8, 3, 3)), rng.uniform(0.02, 0.4, 3)) for _ in range(400)])
    hidden = behind_the_measured(boxes, depth_tiles(depth, CAMERA, POSE))
    assert 20 < hidden.sum() < 380
    for box in boxes[hidden]:
        x, y, z = rng.uniform(box[:3], box[3:6], (200, 3)).T
        u, v = np.floor(32.0 - 40.0 * y / x).astype(int), np.floor(24.0 - 40.0 * z / x).astype(int)
        inside = (u >= 0) & (u < 64) & (v >= 0) & (v < 48)
        measured = depth[v[inside], u[inside]]
        assert (measured > 0).all() and (measured + MARGIN < x[inside]).all()


def test_chunks_behind_a_wall_are_skipped_where_a_depth_is_known():
    rng = np.random.default_rng(1)
    count = 80 * BLOCK
    block = np.zeros((14, count), np.float32)
    behind = np.arange(count) >= count // 2
    block[0] = np.where(behind, 5.0, 1.9) + rng.uniform(0, 0.05, count)
    block[1:3] = rng.uniform(-0.3, 0.3, (2, count))
    block[3], block[7:10] = 1.0, -5.0
    gaussians = GaussianMap()
    gaussians.append(block)
    parts = MapParts(gaussians)
    assert not parts.unseen(CAMERA, POSE).any()
    assert parts.unseen(CAMERA, POSE, WALL).tolist() == [False] * 10 + [True] * 10
