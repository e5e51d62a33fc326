"""Which region of free space an agent is put into. Scenes are as small as their kinds allow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from activestructure_gym.errors import InputError, InputWarning
from activestructure_gym.geometry import look_along
from activestructure_gym.ground_truth import check_start_pose, ground_truth_of, warn_if_hardly_seen
from activestructure_gym.ground_truth.free_space import compute_free_space
from activestructure_gym.ground_truth.regions import Regions
from activestructure_gym.scenes.loaders.units import ceiling_height


def outward(low, high):
    """A box whose triangles all face outward, as modelling programs write a solid body."""
    import trimesh

    body = trimesh.creation.box(bounds=np.array([low, high], float))
    return np.asarray(body.vertices), np.asarray(body.faces)


def sheet(*corners, flipped: bool = False):
    """A quadrilateral with its front where its corners turn counterclockwise."""
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    return np.array(corners, float), faces[:, ::-1] if flipped else faces


def level(x0, x1, y0, y1, z, **options):
    return sheet((x0, y0, z), (x1, y0, z), (x1, y1, z), (x0, y1, z), **options)


def walls(low, high):
    """The four sides of a box, each wound both ways like the tests' boxes."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    ring = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
    return [
        sheet((*a, z0), (*b, z0), (*b, z1), (*a, z1))
        for a, b in zip(ring, [*ring[1:], ring[0]], strict=True)
    ]  # fmt: skip


def hills(side=8.0, step=0.5):
    """A terrain that rolls by half a metre, facing up."""
    count = round(side / step) + 1
    x, y = np.meshgrid(np.arange(count) * step, np.arange(count) * step, indexing="ij")
    vertices = np.stack([x, y, 0.25 * np.sin(x) * np.cos(0.8 * y)], axis=-1).reshape(-1, 3)
    corner = (np.arange(count - 1)[:, None] * count + np.arange(count - 1)).ravel()
    faces = [[corner, corner + count, corner + count + 1], [corner, corner + count + 1, corner + 1]]
    return vertices, np.concatenate([np.stack(face, axis=1) for face in faces])


@pytest.fixture(params=["facing out", "wound both ways"])
def camp(request, make_scene, make_box, join):
    """Hills with three blocks on them, and below them a closed gap down to a base plate."""
    block = outward if request.param == "facing out" else make_box
    blocks = [block((x, y, -0.3), (x + 1.2, y + 1.0, 2.8)) for x, y in ((1, 1), (5, 2), (3, 5))]
    land = hills()
    if request.param != "facing out":
        land = land[0], np.where(np.arange(len(land[1]))[:, None] % 2, land[1], land[1][:, ::-1])
    skirt = walls((0, 0, -2.0), (8, 8, 0.1)) + [level(0, 8, 0, 8, -2.0, flipped=True)]
    return make_scene(*join(land, *skirt, *blocks), name=f"camp {request.param}")


def test_open_ground_is_used_and_not_the_gap_below_it(camp):
    regions = Regions(camp)
    assert not regions.used.enclosed and regions.used.ground.ceiling_height is None
    space = ground_truth_of(camp).free_space
    heights = space.start_poses[:, 2, 3]
    assert len(heights) == 16 and heights.min() > 0.8  # above the hills, not in the gap
    assert space.centers(space.free_voxels)[:, 2].max() < camp.bounds[1, 2]  # the top of the bounds is the lid
    gap = regions.at(np.array([4.0, 4.0, -1.0]))
    assert gap is not None and gap.enclosed and gap is not regions.used and len(regions.places) == 2
    assert gap.volume == pytest.approx(8 * 8 * 1.9, rel=0.15)


def test_the_gap_below_is_used_where_it_is_asked_for(camp):
    space = ground_truth_of(replace(camp, inside=(4.0, 4.0, -1.0))).free_space
    assert space.start_poses[:, 2, 3].max() < 0


def test_a_glass_house_is_used_at_its_floor_and_not_below(make_scene, make_box, join):
    """Posts and beams without panes on a slab that is hollow and reaches 0.6 m below the floor."""
    slab = make_box((0, 0, -0.6), (5, 4, 0.0))
    posts = [make_box((x, y, 0), (x + 0.1, y + 0.1, 2.6)) for x in (0, 1.6, 3.3, 4.9) for y in (0, 3.9)]
    beams = [make_box((0, y, 2.5), (5, y + 0.1, 2.6)) for y in (0, 1.9, 3.9)]
    table = make_box((2, 1.5, 0.0), (3, 2.3, 0.8))
    scene = make_scene(*join(slab, *posts, *beams, table), name="glass house")
    starts = ground_truth_of(scene).free_space.start_poses[:, 2, 3]
    assert ((starts > 1.1) & (starts < 1.6)).all()
    check_start_pose(ground_truth_of(scene), look_along(np.array([1.0, 2.0, 1.4]), np.array([1.0, 0, 0])), 0.3)


@pytest.fixture(scope="module")
def storeys(make_scene, make_box, join):
    """A wide low storey, and on it a smaller one that is higher and holds more air; nothing joins them."""
    lower, upper = make_box((0, 0, 0), (5, 4, 2.2)), make_box((0, 0, 2.4), (4.2, 4, 6.4))
    table = make_box((1, 1, 0), (1.4, 3, 0.9))
    return make_scene(*join(lower, upper, table), name="storeys")


def test_of_two_storeys_the_one_with_more_level_ground_is_used_and_both_are_listed(storeys):
    regions = Regions(storeys)
    lower, upper = regions.places
    assert upper.volume > lower.volume and regions.used is lower
    assert lower.ground.floor == pytest.approx(0.0, abs=1e-6) and upper.ground.floor == pytest.approx(2.4)
    assert upper.ground.ceiling_height == pytest.approx(4.0, abs=0.01)
    assert regions.level_area(lower) > 1.1 * regions.level_area(upper)
    for region in (lower, upper):
        assert regions.at(regions.name_of(region)) is region


@pytest.mark.slow
def test_inside_is_part_of_the_scene_and_of_every_key(storeys):
    other = replace(storeys, inside=(2.0, 2.0, 4.0))
    assert other.content_hash != storeys.content_hash
    assert replace(other, inside=None).content_hash == storeys.content_hash
    first, second = ground_truth_of(storeys), ground_truth_of(other)
    assert first.free_space.start_poses[:, 2, 3].max() < 2.2 < second.free_space.start_poses[:, 2, 3].min()
    seen = second.observable_surface.points[:, 2]
    assert seen.min() > 2.3 and first.observable_surface.points[:, 2].max() < 2.3


@pytest.mark.parametrize(
    ("position", "said"),
    [
        ((2.0, 2.0, 4.0), r"free, but in another region .* region 2 of `asg list scenes`, .* inside=2,2,4 "),
        ((1.2, 2.0, 0.4), "inside a wall or furniture"),
        ((0.0, 2.0, 1.0), "inside a wall or furniture"),
        ((0.03, 2.0, 1.0), r"0.03 m from the nearest surface, but needs 0.45 m"),
        ((4.6, 2.0, 4.0), "outside of the rooms"),
        ((9.0, 2.0, 1.0), "outside the scene's bounds, which go from"),
    ],
)
def test_a_refused_start_names_the_true_reason(storeys, position, said):
    with pytest.raises(InputError, match=said) as caught:
        check_start_pose(ground_truth_of(storeys), look_along(np.array(position), np.array([1.0, 0, 0])), 0.45)
    assert "nearest free start" in str(caught.value) and "\n" not in str(caught.value)


def test_inside_a_wall_names_the_nearest_free_point(storeys):
    for point, said in (((2.0, 2.0, 2.3), "inside a wall"), ((4.6, 2.0, 4.0), "outside of the rooms")):
        with pytest.raises(
            InputError, match=f"is not in free space, but {said}.*; the nearest free point is"
        ) as caught:
            compute_free_space(replace(storeys, inside=point))
        named = tuple(float(value) for value in str(caught.value).rpartition(" is ")[2].split(","))
        assert np.linalg.norm(np.array(named) - point) < 1.2
        compute_free_space(replace(storeys, inside=named))


def test_a_house_without_ceiling_is_used_up_to_its_walls_and_has_no_ceiling(make_scene, make_box, join):
    outer, inner = walls((0, 0, 0), (5, 4, 2.6)), walls((0.2, 0.2, 0), (4.8, 3.8, 2.6))
    rims = [level(0, 5, 0, 0.2, 2.6), level(0, 5, 3.8, 4, 2.6), level(0, 0.2, 0, 4, 2.6), level(4.8, 5, 0, 4, 2.6)]
    cupboard = make_box((0.3, 0.3, 0), (1.5, 0.9, 2.2))
    scene = make_scene(*join(*outer, *inner, *rims, level(0, 5, 0, 4, 0.0), cupboard), name="dollhouse")
    assert ceiling_height(scene) is None
    regions = Regions(scene)
    assert regions.used.enclosed and regions.places == [regions.used]
    assert regions.used.ground.ceiling_height is None
    lid = level(0, 5, 0, 4, 2.6)
    assert ceiling_height(make_scene(*join(*inner, level(0, 5, 0, 4, 0.0), lid, cupboard))) == pytest.approx(2.6)


def test_ground_around_solid_blocks_is_used_and_not_the_inside_of_a_block(make_scene, join):
    blocks = [outward((x, 1, 0.0), (x + 3, 4, 3)) for x in (1, 6)]
    scene = make_scene(*join(level(0, 10, 0, 7, 0.0), *blocks), name="city")
    regions = Regions(scene)
    assert not regions.used.enclosed
    starts = ground_truth_of(scene).free_space.start_poses[:, :3, 3]
    assert ((starts[:, 2] > 1.1) & (starts[:, 2] < 1.6)).all()  # on the street


def test_a_yard_is_used_as_a_whole_and_not_a_strip_along_its_wall(make_scene, join):
    scene = make_scene(*join(level(-3, 12, -3, 12, 0.0), *walls((0, 0, 0), (9, 9, 2.2))), name="yard")
    regions = Regions(scene)
    assert regions.level_area(regions.used) > 0.8 * 9 * 9
    assert regions.at(np.array([4.5, 4.5, 1.4])) is regions.used is regions.at(np.array([0.4, 4.5, 1.0]))
    around = regions.at(np.array([-1.5, -1.5, 1.4]))
    assert around is not None and around is not regions.used


@pytest.mark.parametrize("wall", [0, 2])
def test_a_house_with_an_open_front_on_open_ground_is_used_inside(make_scene, make_box, join, wall):
    sides = walls((0, 0, 0), (5, 4, 2.6))
    del sides[wall]
    bed = make_box((1, 1, 0), (2, 3, 0.5))
    scene = make_scene(*join(level(-3, 8, -3, 7, 0.0), *sides, level(0, 5, 0, 4, 2.6), bed), name="open front")
    regions = Regions(scene)
    assert regions.used.enclosed and regions.level_area(regions.used) == pytest.approx(20, rel=0.2)
    assert [region.enclosed for region in regions.places] == [False, True]


def test_an_outdoor_scan_with_holes_in_its_ground_is_used(make_scene, make_box, join):
    land = hills()
    middle = land[0][land[1]].mean(axis=1)
    whole = ~((np.abs(middle[:, :2] - [5, 5]) < 0.8).all(axis=1) | (np.abs(middle[:, :2] - [2, 7]) < 0.6).all(axis=1))
    trunk = make_box((6, 2, -0.3), (6.5, 2.5, 3))
    scene = make_scene(*join((land[0], land[1][whole]), trunk), name="scan")
    space = ground_truth_of(scene).free_space
    assert len(space.start_poses) == 16 and np.isfinite(space.height).all() and space.volume > 120


def test_a_closed_room_is_found_as_ever_by_itself(furnished_room):
    """One region; neither its cupboard nor what is open to the sky is a place."""
    regions = Regions(furnished_room)
    assert regions.places == [regions.used] and regions.used.enclosed
    assert "open_air" not in Regions(furnished_room).__dict__


def test_a_space_behind_a_crack_is_a_region_of_its_own(make_scene, make_box, join):
    room = make_box((0, 0, 0), (6, 3, 2.5))

    def wall(y0, y1):
        return sheet((3.53, y0, 0), (3.53, y1, 0), (3.53, y1, 2.5), (3.53, y0, 2.5))

    cracked = Regions(make_scene(*join(room, wall(0, 1.4), wall(1.6, 3)), name="crack"))
    assert len(cracked.places) == 2 and cracked.used.ground.level_area == pytest.approx(3.5 * 3, rel=0.15)
    door = Regions(make_scene(*join(room, wall(0, 1.0), wall(2.0, 3)), name="door"))
    assert len(door.places) == 1


def test_little_that_can_be_seen_is_warned_of(make_scene, make_box, join):
    hidden = [make_box((0.2 + 0.5 * k, 0.2, 0.05), (0.6 + 0.5 * k, 2.8, 2.45)) for k in range(6)]
    nested = [
        make_box(tuple(low[0] + 0.03), tuple(high - 0.03)) for low, high in ((b[0], b[0].max(axis=0)) for b in hidden)
    ]
    more = [make_box(tuple(b[0][0] + 0.06), tuple(b[0].max(axis=0) - 0.06)) for b in hidden]
    scene = make_scene(*join(make_box((0, 0, 0), (6, 3, 2.5)), *hidden, *nested, *more), name="stuffed")
    with pytest.warns(
        InputWarning, match="only .* % of the surface can be seen .*`asg list scenes SCENE` lists the regions"
    ):
        warn_if_hardly_seen(ground_truth_of(scene))
