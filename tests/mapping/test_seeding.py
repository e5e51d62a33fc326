"""Where seeds go and how they lie, worked by hand on walls."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.mapping.seeding import grid_pixels, missing_pixels, pixel_samples, seed_disks, surface_steps

CAMERA = PinholeCamera.from_size(8, 6)  # f = 4, centre (4, 3)


def _frame(depth, pose=None):
    depth = np.broadcast_to(np.asarray(depth, np.float32), (6, 8)).copy()
    rgb = np.arange(6 * 8 * 3, dtype=np.uint8).reshape(6, 8, 3)
    return Frame(rgb, depth, np.eye(4) if pose is None else pose, CAMERA)


def _disks(frame, rows, columns, sigma):
    """A disk per pixel, all of one size."""
    rows, columns = np.asarray(rows), np.asarray(columns)
    return seed_disks(frame, pixel_samples(frame, rows, columns), np.full(len(rows), sigma))


def _third_axes(block):  # [n, 3] the disks' normals
    return Rotation.from_quat(block[3:7].T, scalar_first=True).as_matrix()[:, :, 2]


def test_wall_facing_the_camera():
    """2 m in front; pixel (row 2, column 6) looks along ((6.5 - 4) / 4, (2.5 - 3) / 4, 1) = (.625, -.125, 1)."""
    block = _disks(_frame(2.0), [2], [6], 0.6)
    assert block.dtype == np.float32 and block.shape == (14, 1)
    assert block[:3, 0] == pytest.approx([1.25, -0.25, 2.0])
    # A tenth of the size across.
    assert np.exp(block[7:10, 0]) == pytest.approx([0.6, 0.6, 0.06])
    assert np.abs(_third_axes(block)[0]) == pytest.approx([0, 0, 1])
    assert 1 / (1 + np.exp(-block[10, 0])) == pytest.approx(0.9)
    assert block[11:, 0] * 255 == pytest.approx(3 * (2 * 8 + 6) + np.arange(3))


def test_seeds_move_with_the_camera():
    """Looking along +y from (1, 2, 3): camera x, y, z are world +x, -z, +y."""
    pose = look_along(np.array([1.0, 2.0, 3.0]), np.array([0.0, 1.0, 0.0]))
    block = _disks(_frame(2.0, pose), [2], [6], 0.6)
    assert block[:3, 0] == pytest.approx([1 + 1.25, 2 + 2.0, 3 + 0.25])
    assert np.abs(_third_axes(block)[0]) == pytest.approx([0, 1, 0], abs=1e-6)


@pytest.mark.parametrize("normal", [(0, 0, -1), (0.5, 0, -1), (-0.4, 0.7, -1), (0, -1.2, -1), (0.2, 0.1, -0.3)])
def test_disks_lie_in_a_slanted_plane(normal):
    """Plane n.p = -2|n|: one-sided differences are exact on planes, at image borders too."""
    normal = np.array(normal) / np.linalg.norm(normal)
    along_ray = -CAMERA.rays() @ normal
    depth = np.where(along_ray > 0.15, 2.0 / np.maximum(along_ray, 1e-9), 0.0)  # no return nearly edge-on
    frame = _frame(depth)
    rows, columns = np.nonzero(frame.depth)
    per_column, per_row, defined = surface_steps(frame, rows, columns)
    assert defined.mean() > 0.9  # all but pixels at the border to no return
    assert np.abs(per_column @ normal)[defined].max() < 1e-5
    assert np.abs(per_row @ normal)[defined].max() < 1e-5
    block = _disks(frame, rows, columns, 0.1)
    assert np.abs(_third_axes(block)[defined] @ normal).min() > 1 - 1e-6
    assert block[7:10, defined] - block[8, defined] == pytest.approx(np.tile([[0], [0], [np.log(0.1)]], defined.sum()))


@pytest.mark.parametrize("slope", [0.0, 1.0, 2.0])
def test_disks_on_a_slope_are_round(slope):
    """Plane z = 2 + slope * x: sigmas are given in the plane, and the first axis goes up the slope."""
    camera = PinholeCamera(9, 7, 400.0, 400.0, 4.5, 3.5)  # a narrow view: perspective changes nothing
    depth = (2.0 / (1.0 - slope * camera.rays()[..., 0])).astype(np.float32)
    block = _disks(Frame(np.zeros((7, 9, 3), np.uint8), depth, np.eye(4), camera), [3], [4], 0.02)
    assert np.exp(block[7:10, 0]) == pytest.approx([0.02, 0.02, 0.002])
    long = Rotation.from_quat(block[3:7, 0], scalar_first=True).as_matrix()[:, 0]
    if slope:
        assert np.abs(long @ [1, 0, slope]) / np.sqrt(1 + slope**2) == pytest.approx(1, abs=1e-3)


def test_a_sample_between_pixels_lies_as_its_pixel_does():
    """Of a wall and a floor: size, place and colour are the sample's own, the direction that of its pixel."""
    frame = _frame(2.0)
    pixel = pixel_samples(frame, np.array([2, 3]), np.array([6, 1]))
    assert pixel.pixels.tolist() == [22, 25] and pixel.colors[1] * 255 == pytest.approx([75, 76, 77])
    assert pixel.points == pytest.approx(np.array([[1.25, -0.25, 2.0], [-1.25, 0.25, 2.0]]))
    between = pixel._replace(points=pixel.points + np.float32([0.1, 0.2, 0.0]), colors=pixel.colors / 2)
    block = seed_disks(frame, between, np.array([0.6, 0.3]), thickness=0.2, opacity=0.75)
    assert block[:3].T == pytest.approx(pixel.points + [0.1, 0.2, 0.0])
    assert block[11:].T == pytest.approx(pixel.colors / 2)
    assert np.exp(block[7:10].T) == pytest.approx(np.array([[0.6, 0.6, 0.12], [0.3, 0.3, 0.06]]))
    assert 1 / (1 + np.exp(-block[10])) == pytest.approx([0.75] * 2)
    assert np.abs(_third_axes(block)[:, 2]) == pytest.approx([1, 1])


@pytest.mark.parametrize("direction", np.vstack([np.eye(3), -np.eye(3), [[0.6, -0.64, -0.48]]]))
def test_rotation_onto_any_normal(direction):
    """Also for a ceiling (normal straight down), where the shortest rotation of +z would be half a turn."""
    side = np.array([1.0, 0, 0]) if abs(direction[0]) < 0.5 else np.array([0, 1.0, 0])
    right = np.cross(direction, side)
    right /= np.linalg.norm(right)
    pose = np.eye(4)  # a camera looking against the normal
    pose[:3, :3] = np.stack([right, np.cross(-direction, right), -direction], axis=1)
    block = _disks(_frame(1.0, pose), [3], [3], 0.3)
    assert np.linalg.norm(block[3:7, 0]) == pytest.approx(1)
    assert np.abs(_third_axes(block)[0] @ direction) == pytest.approx(1)


def test_differences_stay_on_the_near_side_of_an_edge():
    depth = np.full((6, 8), 1.0)
    depth[:, 4:] = 3.0
    per_column, per_row, defined = surface_steps(_frame(depth), np.array([2, 2]), np.array([3, 4]))
    assert defined.all()
    assert per_column == pytest.approx(np.array([[0.25, 0, 0], [0.75, 0, 0]]))
    assert per_row == pytest.approx(np.array([[0, 0.25, 0], [0, 0.75, 0]]))


def test_balls_where_the_direction_is_unknown():
    depth = np.zeros((6, 8))
    depth[2, 3] = 2.0  # alone: no neighbour
    depth[5, 5:8] = 2.0  # a row without a neighbour above or below
    # A column of one pixel 1 m before a wall at 3 m. A plane from the column to the wall would be seen under the angle
    # between pixels, 1 / 80 = .72 degrees, times 3 m / 1 m = 2.1 degrees: less than the 2.9 of a cosine of .05.
    depth[0:2, 1] = 2.0
    depth[0:2, [0, 2]] = 3.0
    camera = PinholeCamera(8, 6, 80.0, 80.0, 4.0, 3.0)
    frame = Frame(np.zeros((6, 8, 3), np.uint8), depth.astype(np.float32), np.eye(4), camera)
    block = _disks(frame, [2, 5, 0], [3, 6, 1], 0.03)
    assert np.exp(block[7:10]) == pytest.approx(np.full((3, 3), 0.03))
    assert block[3:7] == pytest.approx(np.array([[1, 0, 0, 0]] * 3).T)


def test_one_seed_per_cell_of_the_grid():
    everywhere = np.ones((6, 8), bool)
    rows, columns = grid_pixels(everywhere, 2)
    assert sorted(set(rows)) == [1, 3, 5] and sorted(set(columns)) == [1, 3, 5, 7] and len(rows) == 12
    rows, columns = grid_pixels(everywhere, 3)  # the middle pixel of every 3 x 3 cell
    assert sorted(set(rows)) == [1, 4] and sorted(set(columns)) == [1, 4, 7]
    assert len(grid_pixels(everywhere, 1)[0]) == 48
    assert len(grid_pixels(~everywhere, 2)[0]) == 0


def test_nothing_is_missing_where_the_map_agrees():
    depth = np.full((6, 8), 2.0)
    alpha = np.full((6, 8), 0.8)
    assert not missing_pixels(depth, 0.8 * depth, alpha).any()


def test_transparent_pixels_are_missing_where_there_is_a_return():
    depth = np.full((6, 8), 2.0)
    depth[0] = 0.0
    alpha = np.full((6, 8), 0.8)
    alpha[:3, 0] = 0.49
    missing = missing_pixels(depth, alpha * 2.0, alpha)
    assert np.argwhere(missing).tolist() == [[1, 0], [2, 0]]


def test_surfaces_in_front_of_the_map_are_missing():
    """The map is 4 cm, 2 cm or -1 m too deep; the median error is 0, so the floor of 3 cm decides."""
    depth = np.full((6, 8), 2.0)
    shown = depth.copy()
    shown[1, :3] += [0.04, 0.02, -1.0]
    alpha = np.full((6, 8), 0.8)
    assert np.argwhere(missing_pixels(depth, alpha * shown, alpha)).tolist() == [[1, 0]]


def test_tolerance_grows_with_the_median_error():
    """All pixels are 1 mm off, so 50 times the median is 5 cm: 4 cm are no longer in front, 6 cm are."""
    depth = np.full((6, 8), 2.0)
    shown = depth + 0.001
    shown[1, :2] = 2.0 + np.array([0.04, 0.06])
    alpha = np.ones((6, 8))
    assert np.argwhere(missing_pixels(depth, shown, alpha)).tolist() == [[1, 1]]
