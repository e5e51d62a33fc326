"""Which keyframes saw which Gaussian, on walls and single Gaussians by hand."""

from __future__ import annotations

import numpy as np

from activestructure_gym.features.view_directions import DIRECTIONS, bin_table, shortest_axes, view_directions
from activestructure_gym.geometry import PinholeCamera, fibonacci_directions, look_along
from activestructure_gym.mapping import Mapper, MapperConfig
from activestructure_gym.mapping.gaussian_map import LOG_SCALE, QUATERNION, ROWS, GaussianMap
from activestructure_gym.sensors import Frame

CAMERA = PinholeCamera.from_size(64, 36, 90.0)


def mapper_of(means: list, frames: list[Frame], *, isotropic: bool = False) -> Mapper:
    """Gaussians whose thin axis is world x, and keyframes that mapped nothing."""
    config = MapperConfig(isotropic=isotropic, iterations=0)
    mapper = Mapper(config, np.random.default_rng(0))
    block = np.zeros((ROWS, len(means)), np.float32)
    block[0:3] = np.transpose(means)
    block[QUATERNION.start] = 1.0
    block[LOG_SCALE] = np.log([[0.01], [0.1], [0.1]])
    mapper.map.append(block)
    for frame in frames:
        mapper._store.append(frame, new_share=0.0)
    return mapper


def frame(position: list, direction: list, depth: float) -> Frame:
    pose = look_along(np.array(position, float), np.array(direction, float))
    return Frame(np.zeros((36, 64, 3), np.uint8), np.full((36, 64), depth, np.float32), pose, CAMERA)


def test_one_look_by_hand() -> None:
    # 2 m in front of the camera along its axis: near = 1 - 2/5, straight on.
    seen = view_directions(mapper_of([[2.0, 0.0, 0.0]], [frame([0, 0, 0], [1, 0, 0], 2.0)]))
    assert seen.count.tolist() == [1]
    np.testing.assert_allclose(seen.nearness, [0.6])
    np.testing.assert_allclose(seen.concentration, [1.0])
    nearest = int((fibonacci_directions(DIRECTIONS) @ [-1.0, 0.0, 0.0]).argmax())
    words = [int(word) for word in seen.bins[0]]
    assert words[nearest >> 6] == 1 << (nearest & 63) and words[1 - (nearest >> 6)] == 0


def test_what_a_keyframe_does_not_see() -> None:
    means = [
        [2.0, 0.0, 0.0],
        [2.1, 0.0, 0.0],  # on the other side of the measured wall
        [2.04, 0.0, 0.0],  # behind its surface by less than the slack
        [-1.0, 0.0, 0.0],  # behind the camera
        [2.0, 3.0, 0.0],  # beside the image
    ]
    wall = [frame([0, 0, 0], [1, 0, 0], 2.0)]
    assert view_directions(mapper_of(means, wall)).count.tolist() == [1, 0, 1, 0, 0]
    assert view_directions(mapper_of(means, [frame([0, 0, 0], [1, 0, 0], 0.0)])).count.sum() == 0  # no return, no sight
    assert view_directions(mapper_of(means, [])).count.sum() == 0


def test_on_slanted_surface_the_deepest_neighbour_of_a_pixel_counts() -> None:
    steep = frame([0, 0, 0], [1, 0, 0], 2.0)
    steep.depth[:] += 0.1 * np.arange(64, dtype=np.float32)
    column = int(CAMERA.cx)  # the optical axis is at its left side
    means = [[float(steep.depth[0, column + beyond]) + 0.04, 0.0, 0.0] for beyond in (0, 1, 2)]
    assert view_directions(mapper_of(means, [steep])).count.tolist() == [1, 1, 0]
    steep.depth[:] = 5.2 + 0.1 * (np.arange(36, dtype=np.float32)[:, None] - 18)  # the same from row to row
    assert view_directions(mapper_of(means, [steep])).count.tolist() == [1, 1, 0]


def test_at_the_edge_of_an_object_the_background_reveals_nothing_behind_it() -> None:
    edge = frame([0, 0, 0], [1, 0, 0], 2.0)
    edge.depth[:, int(CAMERA.cx) + 1 :] = edge.depth[int(CAMERA.cy) + 1 :] = 4.0
    means = [[2.0, 0.0, 0.0], [2.14, 0.0, 0.0], [2.16, 0.0, 0.0], [3.9, 0.0, 0.0]]
    assert view_directions(mapper_of(means, [edge])).count.tolist() == [1, 1, 0, 0]


def test_looks_from_several_sides() -> None:
    # Straight on from 2 m and, turned by 60 degrees about z, from 2 m: v1 v2 = 1/2, |mean| = sqrt(3)/2.
    c, s = 0.5, np.sqrt(0.75)
    frames = [frame([0, 0, 0], [1, 0, 0], 2.0), frame([2 - 2 * c, -2 * s, 0], [c, s, 0], 2.0)]
    seen = view_directions(mapper_of([[2.0, 0.0, 0.0]], frames))
    np.testing.assert_allclose(seen.nearness, [0.6 + 0.6 * c], rtol=1e-6)
    np.testing.assert_allclose(seen.concentration, [np.sqrt(0.75)], rtol=1e-6)
    assert sum(int(word).bit_count() for word in seen.bins[0]) == 2
    # From behind: the side that was seen more is the front.
    frames += [frame([5, 0, 0], [-1, 0, 0], 3.0)]
    seen = view_directions(mapper_of([[2.0, 0.0, 0.0]], frames))
    np.testing.assert_allclose(seen.nearness, [0.9], rtol=1e-6)
    np.testing.assert_allclose(seen.concentration, [np.sqrt(0.75)], rtol=1e-6)
    np.testing.assert_allclose(seen.normals, [[-1.0, 0.0, 0.0]], atol=1e-6)
    assert seen.count.tolist() == [3] and np.isclose(seen.sum[0, 0], -0.5)
    # A ball has no normal: the oblique look counts whole.
    balls = mapper_of([[2.0, 0.0, 0.0]], frames[:2], isotropic=True)
    np.testing.assert_allclose(view_directions(balls).nearness, [1.2], rtol=1e-6)


def test_a_far_look_is_counted_and_leaves_the_confidence_as_it_is() -> None:
    seen = view_directions(mapper_of([[6.0, 0.0, 0.0]], [frame([0, 0, 0], [1, 0, 0], 6.0)]))
    assert (seen.count[0], seen.nearness[0], seen.concentration[0]) == (1, 0.0, 0.0) and not seen.normals.any()
    c, s = np.cos(np.radians(80.0)), np.sin(np.radians(80.0))
    far = frame([2 - 6 * c, -6 * s, 0], [c, s, 0], 6.0)
    seen = view_directions(mapper_of([[2.0, 0.0, 0.0]], [frame([0, 0, 0], [1, 0, 0], 2.0), far]))
    np.testing.assert_allclose((*seen.nearness, *seen.concentration), (0.6, 1.0))  # so C = 0.6
    assert seen.count.tolist() == [2]


def test_the_back_of_a_thin_panel_is_no_other_direction_of_its_front() -> None:
    looks = [frame([-1.5, 0, 0], [1, 0, 0], 3.5), frame([6.0, 0, 0], [-1, 0, 0], 4.0)]
    seen = view_directions(mapper_of([[2.0, 0.0, 0.0]], looks))
    np.testing.assert_allclose((*seen.nearness, *seen.concentration), (0.3, 1.0))  # so C = 0.3
    np.testing.assert_allclose(np.linalg.norm(seen.sum, axis=1), [0.0], atol=1e-12)


def test_every_direction_finds_its_bin_or_a_neighbour(rng: np.random.Generator) -> None:
    bins = fibonacci_directions(DIRECTIONS)
    spheres = rng.normal(size=(300, 3))
    spheres /= np.linalg.norm(spheres, axis=1, keepdims=True)
    found = []
    for direction in spheres:
        # The camera stands in this direction from a ball at the origin.
        seen = view_directions(mapper_of([[0.0, 0.0, 0.0]], [frame(2 * direction, -direction, 2.0)], isotropic=True))
        (word,) = np.flatnonzero(seen.bins[0])
        found.append(64 * word + int(seen.bins[0, word]).bit_length() - 1)
    lost = (bins @ spheres.T).max(axis=0) - (bins[found] * spheres).sum(axis=1)
    assert np.mean(lost < 1e-9) > 0.8  # the others lie at a border of two bins
    assert lost.max() < 0.02
    assert len(np.unique(bin_table())) == DIRECTIONS


def test_the_thin_axis_against_rotation_matrices(rng: np.random.Generator) -> None:
    from scipy.spatial.transform import Rotation

    gaussians = GaussianMap()
    block = rng.normal(size=(ROWS, 50)).astype(np.float32)
    gaussians.append(block)
    matrices = Rotation.from_quat(block[QUATERNION].T, scalar_first=True).as_matrix()
    expected = matrices[np.arange(50), :, block[LOG_SCALE].argmin(axis=0)]
    np.testing.assert_allclose(shortest_axes(gaussians), expected, atol=1e-6)
