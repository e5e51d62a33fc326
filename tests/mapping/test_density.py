"""Where seeds go by distance in space: laws, surfaces worked by hand, and the choice against a search tree."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.mapping import Mapper
from activestructure_gym.mapping.density import COVERED, NO_RETURN, REDUNDANT, SEED, states_of_samples, wanted_spacing
from activestructure_gym.mapping.gaussian_map import GaussianMap
from activestructure_gym.mapping.map_passes import CHUNK
from activestructure_gym.mapping.surface_links import proven_same_surface, surface_links
from activestructure_gym.mapping.surface_samples import samples_between
from tests.mapping.surfaces import FORWARD, SPACING, all_samples, dense, farthest, linked, mapped, picture, plane

NOBODY = np.empty((14, 0), np.float32)


def checkers(points: np.ndarray) -> np.ndarray:
    """Squares of 30 cm in y and z."""
    return (np.floor(points[:, 1] / 0.3) + np.floor(points[:, 2] / 0.3)) % 2 == 0


def normals(mapper: Mapper) -> np.ndarray:  # [n, 3]
    quaternions = mapper.map.parameters[3:7, : mapper.map.count].T
    return np.asarray(Rotation.from_quat(quaternions, scalar_first=True).as_matrix()[:, :, 2])


# The spacing that is wanted


def test_spacing_by_hand() -> None:
    """f = 4, so a pixel at 2 m is half a metre wide; 10 levels of 255 are a contrast of .039."""
    camera = PinholeCamera.from_size(8, 6)
    rgb, depth = np.full((6, 8, 3), 100, np.uint8), np.full((6, 8), 2.0, np.float32)
    rgb[2, 3, 1] = 110
    depth[4:, 6:] = 1.0
    frame = Frame(rgb, depth, np.eye(4), camera)
    links = surface_links(frame.depth)
    spacing = wanted_spacing(frame, links, plain=0.9, pixels=1.0, contrast=9.5 / 255)
    expected = np.full((6, 8), 0.9, np.float32)
    expected[[2, 2, 2, 1, 3], [3, 2, 4, 3, 3]] = 0.5  # it and its four neighbours
    rim = np.zeros((6, 8), bool)
    rim[4:, 5] = rim[3, 6:] = True
    expected[rim] = 0.5
    rim[4, 6:] = rim[5, 6] = True  # of the nearer surface, where a pixel is a quarter of a metre wide
    rim[5, 7] = True  # a surface of 2 x 2 pixels: nothing tells whether they are one plane
    expected[4:, 6:] = 0.25
    assert spacing == pytest.approx(expected) and spacing.dtype == np.float32
    flat = wanted_spacing(frame, links, plain=0.9, pixels=1.0, contrast=10 / 255)
    assert flat[1:4, 2:5] == pytest.approx(np.full((3, 3), 0.9))
    assert wanted_spacing(frame, links, plain=0.2, pixels=1.0, contrast=0.04) == pytest.approx(np.full((6, 8), 0.2))


def test_a_slanted_plane_has_no_edges_and_a_step_of_three_percent_has() -> None:
    floor = picture([plane([0, 0, -1.2], [0, 0, 1])], direction=[1.0, 0.0, -0.7])
    assert (floor.depth > 0).all() and not fine(floor).any()
    for step, expected in ((0.019, False), (0.031, True)):
        wall = picture([plane([4, 0, 0], [1, 0, 0])])
        wall.depth[:, 40:] *= 1 + step
        assert fine(wall)[:, 39:41].all() == fine(wall).any() == expected


def fine(frame: Frame) -> np.ndarray:  # [H, W] bool
    """Where more is wanted than on plain surface: a thousandth of a pixel apart instead of a metre."""
    return wanted_spacing(frame, surface_links(frame.depth), plain=1.0, pixels=1e-3, contrast=0.04) < 0.5


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize(
    "depths, expected",
    [
        ((3.0, 3.0, 3.0, 2.92, 2.82, 2.727), True),  # a floor in front of a wall: the crease is filled
        # A floor whose slope points at the rim of a box before it (1 / z = .2, .25, .3, then .35 is 2.857 m).
        ((5.0, 4.0, 1 / 0.3, 2.86, 2.86, 2.86), False),
        ((5.0, 4.0, 1 / 0.3, 2.86, 1.9, 1.9), True),  # no plane of the other side is seen
        ((5.0, 4.0, 1 / 0.3, 2.86, 0.0, 2.86), True),
        ((0.0, 4.0, 1 / 0.3, 2.86, 2.86, 2.86), False),  # nor of this one
    ],
)
def test_a_plane_joins_two_pixels_unless_the_other_side_shows_one_that_does_not(depths, expected, turned) -> None:
    column = np.array(depths[::-1] if turned else depths, np.float32)[:, None]
    assert linked(column, 2, 0, down=True) == linked(column.T, 0, 2, down=False) == expected


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize(
    "depths, expected",
    [
        ((1 / 0.2, 1 / 0.25, 1 / 0.3, 1 / 0.35, 1 / 0.4, 1 / 0.45), True),
        ((9.0, 1 / 0.25, 1 / 0.3, 1 / 0.35, 1 / 0.4, 9.0), True),  # both planes agree, though each has two pixels
        ((5.0, 4.0, 1 / 0.3, 2.86, 1.9, 1.9), True),  # one plane of three pixels agrees within 1 %
        ((5.0, 4.0, 1 / 0.3, 2.82, 1.9, 1.9), False),  # it agrees within 2 % only
        ((9.0, 4.0, 1 / 0.3, 2.86, 1.9, 1.9), False),  # two pixels are no proof
    ],
)
def test_one_surface_is_proven_by_two_planes_or_by_three_pixels(depths, expected, turned) -> None:
    column = np.array(depths[::-1] if turned else depths, np.float32)[:, None]
    assert linked(column, 2, 0, down=True)
    row = np.ascontiguousarray(column.T)
    assert proven_same_surface(column, 2, 0, 1, 0) == proven_same_surface(row, 0, 2, 0, 1) == expected
    # Twice as far, the two pixels are 0.95 m apart, and the gap is filled only if the proof holds.
    depth = np.repeat(2 * column, 6, axis=1)
    frame = Frame(np.zeros((6, 6, 3), np.uint8), depth, np.eye(4), PinholeCamera.from_size(6, 6, 10.0))
    between = samples_between(frame, surface_links(depth), np.full(depth.shape, 0.2, np.float32)).pixels
    assert (between // 6 == 2).any() == expected


# Coverage


@pytest.mark.parametrize("distance", [2.0, 2.6, 3.0, 4.0, 4.5, 5.0, 5.3, 6.0, 9.0])
def test_every_point_of_a_wall_has_a_mean_near(distance: float) -> None:
    """Pixels are 5 to 22 cm apart; from one look."""
    wall = picture([plane([distance, 0, 0], [1, 0, 0])])
    assert farthest(dense(wall), mapped(wall)).max() < 1.01 * SPACING


def test_a_second_look_adds_nothing_whatever_is_seen(room_frames: list[Frame]) -> None:
    box = plane([2, 0, 0], [1, 0, 0], lambda p: np.abs(p[:, 1:]).max(axis=1) < 0.5)
    wall, floor = plane([4, 0, 0], [1, 0, 0]), plane([0, 0, -1.2], [0, 0, 1])
    stripes = lambda p: np.floor(p.sum(axis=1) / 0.7) % 2 == 0  # noqa: E731
    frames = [picture([box, wall, floor]), picture([box, wall, floor], paint=stripes), *room_frames]
    frames += [picture([floor], [0, 0, -0.9], paint=stripes, camera=PinholeCamera.from_size(160, 90))]
    for frame in frames:
        mapper = mapped(frame)
        first = mapper.map.parameters[:, : mapper.map.count].copy()
        again = mapper.observe(frame, iterations=0)
        assert (again.added, again.replaced, again.left_out, again.new_share) == (0, 0, 0, 0.0)
        assert np.array_equal(mapper.map.parameters[:, : mapper.map.count], first)


def test_a_plain_wall_gets_what_the_spacing_needs_and_a_painted_one_more() -> None:
    """At .5 m pixels are 1.25 cm apart, 1.2 of them 1.5: nearer than the 4.5 of a plain wall."""
    wall = [plane([0.5, 0, 0], [1, 0, 0])]
    plain, painted = mapped(picture(wall)), mapped(picture(wall, paint=checkers))
    width, height = 79 * 0.0125, 44 * 0.0125
    # At most as many as the densest packing has, discs of half the spacing within the wall and its rim; at least
    # what discs of the spacing need to cover it.
    packed = (width + SPACING) * (height + SPACING) / (np.sqrt(0.75) * SPACING**2)
    assert width * height / (np.pi * SPACING**2) < plain.map.count < packed
    assert 1.05 * plain.map.count < painted.map.count < 79 * 44 / 4
    sizes = painted.map.scales.max(axis=1)
    assert sizes.max() == pytest.approx(1.05 * SPACING) and sizes.min() == pytest.approx(1.05 * 0.015)


def test_the_wall_is_denser_where_it_is_painted() -> None:
    """Half a wall at 50 cm is painted in squares of 3 cm: pixels are 1.25 cm apart, 1.2 of them 1.5."""
    fine = lambda p: (p[:, 1] > 0) & ((np.floor(p[:, 1] / 0.03) + np.floor(p[:, 2] / 0.03)) % 2 == 0)  # noqa: E731
    wall = mapped(picture([plane([0.5, 0, 0], [1, 0, 0])], paint=fine))
    painted = wall.map.means[:, 1] > 0
    assert 2.5 * (~painted).sum() < painted.sum()
    assert np.median(wall.map.scales[painted].max(axis=1)) == pytest.approx(1.05 * 1.2 * 0.0125)
    assert np.median(wall.map.scales[~painted].max(axis=1)) == pytest.approx(1.05 * SPACING)


# Where nothing may stand


def test_nothing_stands_between_a_box_and_the_wall_behind_it() -> None:
    box = plane([2, 0, 0], [1, 0, 0], lambda p: np.abs(p[:, 1:]).max(axis=1) < 0.6)
    mapper = mapped(picture([box, plane([4, 0, 0], [1, 0, 0])]))
    x, sides = mapper.map.means[:, 0], np.abs(mapper.map.means[:, 1:]).max(axis=1)
    on_box, on_wall = np.abs(x - 2) < 0.02, np.abs(x - 4) < 0.02
    assert (on_box | on_wall).all() and on_box.sum() > 300 and on_wall.sum() > 1000
    assert sides[on_box].max() < 0.6
    # Nor do they stand on the part of the wall that the box hides: twice as large from twice as far.
    assert sides[on_wall].min() > 1.2 - 1e-6


def test_nothing_stands_where_nothing_was_measured() -> None:
    wall = picture([plane([4, 0, 0], [1, 0, 0])])
    wall.depth[10:30, 20:60] = 0.0
    mapper = mapped(wall)
    columns, rows = wall.camera.project(
        (mapper.map.means - wall.world_from_camera[:3, 3]) @ wall.world_from_camera[:3, :3]
    ).T
    blind = (rows > 9.51) & (rows < 30.49) & (columns > 19.51) & (columns < 60.49)
    assert not blind.any() and mapper.map.count > 3000
    wall.depth[:] = 0.0
    assert mapped(wall).map.count == 0


def test_lone_pixels_and_lines_are_seeded_where_they_are() -> None:
    wall = picture([plane([4, 0, 0], [1, 0, 0])])
    wall.depth[:] = np.where(np.eye(45, 80) > 0, 4.0, 0.0)
    mapper = mapped(wall)
    assert mapper.map.count == 45
    assert np.sort(mapper.map.means[:, 1]) == pytest.approx(np.sort((39.5 - np.arange(45)) * 0.1))


# Other sides and other distances


def test_a_thin_panel_gets_means_on_both_sides() -> None:
    """2 cm thick, and both sides are seen: disks that face away hold no place."""
    size = lambda p: (np.abs(p[:, 1]) < 0.5) & (np.abs(p[:, 2]) < 0.5)  # noqa: E731
    panel = [plane([0, 0, 0], [1, 0, 0], size), plane([0.02, 0, 0], [1, 0, 0], size)]
    mapper = mapped(picture(panel, [-1.5, 0, 0], FORWARD), picture(panel, [1.5, 0, 0], -FORWARD))
    x = mapper.map.means[:, 0]
    front, back = np.abs(x) < 1e-4, np.abs(x - 0.02) < 1e-4
    assert (front | back).all() and front.sum() == pytest.approx(back.sum(), rel=0.1) and front.sum() > 300
    assert normals(mapper)[front] @ FORWARD == pytest.approx(-1.0, abs=1e-4)
    assert normals(mapper)[back] @ FORWARD == pytest.approx(1.0, abs=1e-4)


def test_refining_one_side_of_a_panel_leaves_the_other_alone() -> None:
    size = lambda p: (np.abs(p[:, 1]) < 0.6) & (np.abs(p[:, 2]) < 0.6)  # noqa: E731
    panel = [plane([0, 0, 0], [1, 0, 0], size), plane([0.02, 0, 0], [1, 0, 0], size)]
    fine = lambda p: (np.floor(p[:, 1] / 0.02) + np.floor(p[:, 2] / 0.02)) % 2 == 0  # noqa: E731
    mapper = mapped(picture(panel, [-1.5, 0, 0], FORWARD), picture(panel, [1.5, 0, 0], -FORWARD))
    back = mapper.map.ids[: mapper.map.count][mapper.map.means[:, 0] > 0.01].copy()
    report = mapper.observe(picture(panel, [-0.3, 0, 0], FORWARD, fine), iterations=0)
    assert report.replaced > 50
    assert set(back) <= set(mapper.map.ids[: mapper.map.count])


def test_coming_closer_to_paint_refines_and_to_plain_wall_adds_nothing() -> None:
    wall = [plane([0, 0, 0], [1, 0, 0])]
    fine = lambda p: (np.floor(p[:, 1] / 0.05) + np.floor(p[:, 2] / 0.05)) % 2 == 0  # noqa: E731
    far, near = [-2.6, 0, 0], [-0.4, 0, 0]
    plain = mapped(picture(wall, far))
    before = plain.map.count
    report = plain.observe(picture(wall, near), iterations=0)
    assert report.replaced == 0 and report.added == 0 and plain.map.count == before
    painted = mapped(picture(wall, far, paint=fine))
    seen = lambda: np.abs(painted.map.means[:, 1:]).max(axis=1) < 0.15  # noqa: E731
    assert np.median(painted.map.scales[seen()].max(axis=1)) == pytest.approx(1.05 * SPACING)
    # From .4 m pixels are 1 cm wide: 1.2 cm between means.
    report = painted.observe(picture(wall, near, paint=fine), iterations=0)
    assert report.replaced > 50 and report.added > 5 * report.replaced and report.new_share > 0.3
    assert np.median(painted.map.scales[seen()].max(axis=1)) == pytest.approx(1.05 * 0.012)
    assert painted.map.scales[seen()].max() < 1.3 * 1.05 * SPACING
    # Going back changes nothing.
    report = painted.observe(picture(wall, far, paint=fine), iterations=0)
    assert (report.replaced, report.added) == (0, 0)


def test_what_is_transparent_holds_no_place() -> None:
    wall = picture([plane([4, 0, 0], [1, 0, 0])])
    mapper = mapped(wall)
    count = mapper.map.count
    mapper.map.parameters[10, :count] = -0.01  # an opacity of just below one half
    assert mapper.observe(wall, iterations=0).added == count
    mapper.map.parameters[10, : mapper.map.count] = 0.01
    assert mapper.observe(wall, iterations=0).added == 0


# The choice against a search tree


def _random_map(rng: np.random.Generator, frame: Frame, count: int) -> GaussianMap:
    """Balls and disks of all directions and opacities: near what is seen, also beside the image, and elsewhere."""
    block = rng.normal(size=(14, count)).astype(np.float32)
    points = frame.camera.backproject(frame.depth).reshape(-1, 3)[rng.integers(frame.depth.size, size=count)]
    pose = frame.world_from_camera
    block[:3] = ((points + rng.normal(0, 0.15, (count, 3))) @ pose[:3, :3].T + pose[:3, 3]).T
    block[:3, ::7] = rng.uniform(-5, 5, (3, len(range(0, count, 7))))
    block[9, ::3] = block[8, ::3]  # balls
    made = GaussianMap()
    made.append(block)
    return made


def states(frame: Frame, spacing: np.ndarray, parameters: np.ndarray, count: int, **options: Any) -> np.ndarray:
    """States of `all_samples`."""
    between = samples_between(frame, surface_links(frame.depth), spacing)
    found = states_of_samples(frame, between, spacing, parameters, count, **options)
    assert np.array_equal(found[: frame.depth.size] == NO_RETURN, frame.depth.ravel() == 0)
    return found[found != NO_RETURN]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("fov", [120.0, 60.0])
def test_states_are_what_a_search_tree_says(seed: int, fov: float) -> None:
    rng = np.random.default_rng(seed)
    camera = PinholeCamera.from_size(24, 18, fov)
    frame = picture(
        [plane([2, 0, 0], [1, 0.3, 0]), plane([0, 0, -1.2], [0, 0, 1])], [0.3, 0.1, 0.2], [1, 0.2, -0.3], checkers,
        camera,
    )  # fmt: skip
    spacing = rng.uniform(0.05, 0.3, frame.depth.shape).astype(np.float32)
    samples = all_samples(frame, spacing)
    gaussians = _random_map(rng, frame, 2 * CHUNK + 100)
    count, rows, pose = gaussians.count, gaussians.parameters, frame.world_from_camera
    leaving = rng.random(count) < 0.2
    found = states(frame, spacing, rows, count, leaving=leaving)

    points = samples.points.astype(float) @ pose[:3, :3].T + pose[:3, 3]
    reach = spacing.ravel()[samples.pixels].astype(float)
    means = rows[:3, :count].T.astype(float)
    axes = Rotation.from_quat(rows[3:7, :count].T, scalar_first=True).as_matrix()[:, :, 2]
    facing = np.einsum("ij,ij->i", axes, pose[:3, 3] - means) > 0
    holding = (rows[10, :count] >= 0) & ~leaving & (facing | ~(rows[9, :count] < rows[8, :count]))
    nearest = cKDTree(means[holding]).query(points)[0]
    clear = np.abs(nearest - reach) > 1e-5  # float32
    assert np.array_equal((found == COVERED)[clear], (nearest <= reach)[clear])
    assert min((found == state).sum() for state in (COVERED, SEED, REDUNDANT)) > 5

    wanted = np.flatnonzero(found == SEED)
    assert (np.diff(wanted) > 0).all()
    apart = np.linalg.norm(points[wanted, None] - points[None, wanted], axis=2)
    earlier = np.tri(len(wanted), k=-1, dtype=bool)  # [later, earlier]
    assert (apart > reach[wanted, None] - 1e-5)[earlier].all()
    spared = np.flatnonzero(found == REDUNDANT)
    near = np.linalg.norm(points[spared, None] - points[None, wanted], axis=2) <= reach[spared, None] + 1e-5
    assert (near & (wanted[None] < spared[:, None])).any(axis=1).all()

    # What the frame cannot show does not count; and without a map nothing is held.
    unseen = np.array([False, True, False])
    fewer = states(frame, spacing, rows, count, leaving=leaving, unseen=unseen)
    holding[CHUNK : 2 * CHUNK] = False
    nearest = cKDTree(means[holding]).query(points)[0]
    clear = np.abs(nearest - reach) > 1e-5
    assert np.array_equal((fewer == COVERED)[clear], (nearest <= reach)[clear])
    assert not (states(frame, spacing, NOBODY, 0) == COVERED).any()


@pytest.mark.parametrize("fov", [60.0, 90.0, 120.0])
@pytest.mark.parametrize("side", [(0, 40), (-1, 40), (22, 0), (22, -1)])
def test_a_mean_beside_the_image_holds_the_places_at_its_rim(fov: float, side: tuple[int, int]) -> None:
    """It stands off the pixel at a right angle to the ray through it, away from the middle of the image."""
    camera = PinholeCamera.from_size(80, 45, fov)
    wall = picture([plane([2, 0, 0], [1, 0, 0])], camera=camera)
    point = camera.backproject(wall.depth)[side].astype(float)
    ray, outwards = point / np.linalg.norm(point), point * [1, 1, 0]
    outwards -= outwards @ ray * ray
    spacing = np.full(wall.depth.shape, 0.2, np.float32)
    index = int(np.ravel_multi_index(np.array(side) % wall.depth.shape, wall.depth.shape))
    for distance, held in ((0.199, True), (0.201, False)):
        block = np.zeros((14, 1), np.float32)
        mean = point + distance * outwards / np.linalg.norm(outwards)
        block[:3, 0], block[3], block[10] = wall.world_from_camera[:3] @ [*mean, 1.0], 1.0, 1.0
        assert (states(wall, spacing, block, 1)[index] == COVERED) == held


def test_of_no_samples_there_are_no_states() -> None:
    wall = picture([plane([4, 0, 0], [1, 0, 0])])
    wall.depth[:] = 0.0
    spacing = np.full(wall.depth.shape, 0.1, np.float32)
    samples = samples_between(wall, surface_links(wall.depth), spacing)
    assert len(samples.pixels) == 0
    assert (states_of_samples(wall, samples, spacing, NOBODY, 0) == NO_RETURN).all()


def test_samples_by_hand() -> None:
    """f = 4 at 2 m: pixels are 50 cm apart. 20 cm of spacing allow 25: two parts, or four samples for each pixel."""
    camera = PinholeCamera.from_size(8, 6)
    rgb = np.repeat(np.arange(8, dtype=np.uint8)[None, :, None] * 20, 6, axis=0).repeat(3, axis=2)
    frame = Frame(rgb, np.full((6, 8), 2.0, np.float32), np.eye(4), camera)
    samples = all_samples(frame, np.full((6, 8), 0.2, np.float32))
    columns, rows = np.meshgrid(np.arange(0, 7.5, 0.5), np.arange(0, 5.5, 0.5))
    expected = np.stack([(columns - 3.5) / 2, (rows - 2.5) / 2, np.full_like(rows, 2.0)], axis=-1).reshape(-1, 3)
    assert len(samples.points) == 15 * 11
    order = np.lexsort(np.round(samples.points.T, 4)[:2])
    assert samples.points[order] == pytest.approx(expected, abs=1e-5)
    assert samples.colors[order, 1] * 255 == pytest.approx(20 * columns.ravel(), abs=1e-3)
    assert samples.pixels[:48].tolist() == list(range(48))  # the pixels' own come first
    assert samples.pixels[order].tolist() == (rows.astype(int) * 8 + columns.astype(int)).ravel().tolist()
    # 40 cm allow half a metre.
    assert len(all_samples(frame, np.full((6, 8), 0.4, np.float32)).pixels) == 48


# The bound
