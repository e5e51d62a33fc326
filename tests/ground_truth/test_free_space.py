from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.ground_truth import truth as truth_module
from activestructure_gym.ground_truth import voxelized as voxelized_module
from activestructure_gym.ground_truth.truth import free_space_of
from activestructure_gym.ground_truth.voxelized import enclosed_share


def _inside(space, low, high) -> np.ndarray:
    """Clearances of the voxel centres inside a box."""
    x, y, z = (np.arange(n) for n in space.clearance.shape)
    centers = space.centers(np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1))
    return space.clearance[((centers > low) & (centers < high)).all(axis=-1)]


@pytest.fixture(scope="module")
def empty_room(make_scene, make_box):
    return make_scene(*make_box((0, 0, 0), (4, 3, 2.5)), name="empty")


def test_clearance_in_an_empty_box_is_the_distance_to_the_nearest_wall(empty_room):
    space = free_space_of(empty_room)
    centers = space.centers(space.free_voxels)
    exact = np.minimum(centers, [4.0, 3.0, 2.5] - centers).min(axis=1)
    clearance = space.clearance[tuple(space.free_voxels.T)]
    assert exact.min() > 0
    # A sample is at most 5 cm beside the nearest surface point: sqrt(d^2 + 0.05^2) - d, 6 mm at 0.2 m.
    assert (clearance >= exact - 1e-5).all()
    assert (clearance <= np.hypot(exact, 0.05) + 1e-5)[exact < 0.5].all()
    np.testing.assert_allclose(clearance, exact, atol=0.12)
    # All voxels but those that the walls cross: at least (4 - 0.3)(3 - 0.3)(2.5 - 0.3) m^3.
    assert 3.7 * 2.7 * 2.2 < space.volume < 4 * 3 * 2.5


def test_height_is_measured_to_whatever_is_below(furnished_room):
    space = free_space_of(furnished_room)
    centers = space.centers(space.free_voxels)
    height = space.height[tuple(space.free_voxels.T)]
    over_table = ((centers[:, :2] > [1.85, 1.25]) & (centers[:, :2] < [2.75, 1.95])).all(axis=1) & (centers[:, 2] > 0.8)
    over_floor = (centers[:, 0] > 3.0) & (centers[:, 1] > 1.0)
    assert over_table.sum() > 50 and over_floor.sum() > 50
    np.testing.assert_allclose(height[over_table], centers[over_table, 2] - 0.74, atol=1e-4)
    np.testing.assert_allclose(height[over_floor], centers[over_floor, 2], atol=1e-4)


def test_closed_furniture_walls_and_the_outside_are_not_free(furnished_room):
    space = free_space_of(furnished_room)
    assert (_inside(space, (0.02, 0.02, 0.0), (1.02, 0.82, 2.0)) == 0).all()  # 1.6 m^3 inside the wardrobe
    outside = [[-0.05, 1.5, 1.2], [4.05, 1.5, 1.2], [2, 1.5, 2.6], [2, 1.5, -0.1], [50, 50, 50], [0.5, 0.4, 1.0]]
    assert (space.clearance_at(np.array(outside)) == 0).all()
    assert space.clearance_at(np.array([[3.2, 2.2, 1.2]]))[0] > 0.6


def test_clearance_between_centres_is_interpolated(empty_room):
    space = free_space_of(empty_room)
    voxels = space.free_voxels[::500]
    np.testing.assert_allclose(space.clearance_at(space.centers(voxels)), space.clearance[tuple(voxels.T)], atol=1e-6)
    a, b = np.array([5, 15, 12]), np.array([6, 15, 12])
    middle = 0.5 * (space.centers(a) + space.centers(b))
    mean = 0.5 * (space.clearance[tuple(a)] + space.clearance[tuple(b)])
    assert space.clearance_at(middle)[0] == pytest.approx(mean)


def test_enclosed_share_of_simple_grids():
    inside = np.ones((20, 16, 12), dtype=bool)
    inside[1:-1, 1:-1, 1:-1] = False
    share = enclosed_share(inside)
    assert (share[1:-1, 1:-1, 1:-1] == 1).all()  # closed on all sides: every direction ends
    assert (enclosed_share(np.zeros((5, 6, 7), dtype=bool)) == 0).all()
    for axis in range(3):
        for side, facing in ((0, -1), (-1, 0)):
            plane = np.zeros((31, 31, 31), dtype=bool)
            np.moveaxis(plane, axis, 0)[side] = True
            seen = np.moveaxis(enclosed_share(plane), axis, 0)
            near = seen[1 if side == 0 else -2, 15, 15]
            assert 0.35 < near <= 0.5  # half of all directions, less those that leave the grid first
            assert seen[side, 15, 15] == 0 or seen[facing, 15, 15] < near  # farther away it is smaller


def test_a_room_without_ceiling_and_one_without_a_wall_are_rooms(make_scene, make_box):
    vertices, faces = make_box((0, 0, 0), (4, 4, 2.5))
    for missing in ((10, 11), (2, 3)):  # two triangles of a side: see the faces of `box`
        kept = np.delete(faces, missing, axis=0)
        space = free_space_of(make_scene(vertices, kept, name=f"open {missing}"))
        assert space.volume > 10.0
        assert len(space.start_poses) >= 8
        assert (space.clearance_at(np.array([[2, 2, 4.0], [2, -1.0, 1.0], [2, 2, -0.5]])) == 0).all()


def test_a_house_on_open_ground_is_free_only_inside(make_scene, make_box, join):
    corners = np.array([[-8, -8, 0], [12, -8, 0], [12, 10, 0], [-8, 10, 0]], dtype=float)
    ground = corners, np.array([[0, 1, 2], [0, 2, 3]])
    house = make_box((0, 0, 0.0), (4, 3, 2.5))
    shell = make_box((-0.2, -0.2, 0.0), (4.2, 3.2, 2.7))  # outer faces: walls 20 cm thick
    space = free_space_of(make_scene(*join(ground, house, shell), name="house"))
    assert 3.5 * 2.5 * 2.0 < space.volume < 30.0
    centers = space.centers(space.free_voxels)
    assert (centers > 0).all() and (centers < [4, 3, 2.5]).all()


def test_a_thin_wall_separates_and_a_door_joins(make_scene, make_box, join):
    room = make_box((0, 0, 0), (6, 3, 2.5))

    def sheet(y0, y1, z1):  # a single sheet at x = 2.53, not aligned with the voxels
        corners = np.array([[2.53, y0, 0], [2.53, y1, 0], [2.53, y1, z1], [2.53, y0, z1]], dtype=float)
        return corners, np.array([[0, 1, 2], [0, 2, 3]])

    closed = free_space_of(make_scene(*join(room, sheet(0, 3, 2.5)), name="closed"))
    assert (_inside(closed, (0, 0, 0), (2.5, 3, 2.5)) == 0).all()  # the smaller room is not reached
    assert (_inside(closed, (2.9, 0.3, 0.3), (5.7, 2.7, 2.2)) > 0).all()
    door = free_space_of(make_scene(*join(room, sheet(0, 1.1, 2.5), sheet(1.9, 3, 2.5)), name="door"))
    assert (_inside(door, (0.3, 0.3, 0.3), (2.2, 2.7, 2.2)) > 0).all()


@pytest.mark.parametrize("shape", ["ground", "crate", "pillar"])
def test_meshes_without_a_room_are_refused_in_one_sentence(make_scene, make_box, shape):
    if shape == "ground":
        mesh = np.array([[0, 0, 0], [9, 0, 0], [9, 9, 0], [0, 9, 0.2]], dtype=float), np.array([[0, 1, 2], [0, 2, 3]])
    elif shape == "crate":
        mesh = make_box((0, 0, 0), (0.7, 0.7, 0.7))
    else:
        mesh = make_box((0, 0, 0), (0.35, 0.35, 8))
    with pytest.raises(InputError, match=f"scene '{shape}' has no free space") as caught:
        free_space_of(make_scene(*mesh, name=shape))
    assert "\n" not in str(caught.value)


def test_sampled_positions_keep_their_limits(furnished_room):
    space = free_space_of(furnished_room)
    first = space.sample_positions(2000, np.random.default_rng(0), min_clearance=0.35, heights=(1.0, 1.6))
    again = space.sample_positions(2000, np.random.default_rng(0), min_clearance=0.35, heights=(1.0, 1.6))
    np.testing.assert_array_equal(first, again)
    assert first.shape == (2000, 3)
    assert (space.clearance_at(first) >= 0.35 - 1e-6).all()
    # True distance to the walls, not the grid's: interpolation and samples cost at most a centimetre or two here.
    assert (np.minimum(first, [4, 3, 2.5] - first).min(axis=1) > 0.33).all()
    down = furnished_room.raycaster.cast(first, np.tile([0.0, 0.0, -1.0], (2000, 1))).distance
    # Within half a voxel of the limits, for the jitter is vertical too; over the table's edge it may jump.
    assert (np.abs(down - 1.3) < 0.35 + 0.01).mean() > 0.98
    assert len(np.unique(np.round(first, 6), axis=0)) > 1990  # jittered, not only centres


def test_limits_that_no_place_satisfies(furnished_room):
    space = free_space_of(furnished_room)
    with pytest.raises(InputError, match="no free place with a clearance of 3.0 m"):
        space.sample_positions(5, np.random.default_rng(0), min_clearance=3.0)
    with pytest.raises(InputError, match="height"):
        space.sample_positions(5, np.random.default_rng(0), heights=(4.0, 5.0))


def test_the_second_time_comes_from_the_cache(empty_room, monkeypatch):
    first = free_space_of(empty_room)
    monkeypatch.setattr(truth_module, "compute_free_space", lambda *_: pytest.fail("computed again"))
    second = free_space_of(empty_room)
    np.testing.assert_array_equal(first.clearance, second.clearance)
    np.testing.assert_array_equal(first.start_poses, second.start_poses)
    assert second.voxel_size == first.voxel_size


def test_large_buildings_get_larger_voxels_and_still_a_free_space(make_scene, make_box, monkeypatch):
    monkeypatch.setattr(voxelized_module, "MAX_VOXELS", 200_000)
    space = free_space_of(make_scene(*make_box((0, 0, 0), (20, 15, 3)), name="hall"))
    assert space.clearance.size <= 200_000 and 0.1 < space.voxel_size < 0.2
    assert space.volume > 0.85 * 20 * 15 * 3 and len(space.start_poses) == 16


@pytest.mark.parametrize("name, volume", [("hotel_room", (80, 105)), ("garage", (60, 85)), ("home_theater", (85, 115))])
def test_real_scenes(shared, name, volume):
    """Volumes measured once and looked at in plan and in views; the hotel's glass front is open."""
    from activestructure_gym.scenes.loaders.mesh_loader import load_mesh_scene

    scene = load_mesh_scene(shared / "scenes" / f"{name}.glb", up="z")
    space = free_space_of(scene)
    assert volume[0] < space.volume < volume[1]
    assert len(space.start_poses) == 16
    # From a free place nearly every ray ends on the scene; outside half of them would not.
    eyes = space.sample_positions(200, np.random.default_rng(0))
    directions = np.random.default_rng(1).normal(size=(200 * 50, 3))
    hits = scene.raycaster.cast(np.repeat(eyes, 50, axis=0), directions)
    assert np.isfinite(hits.distance).mean() > 0.9


def test_a_surface_that_is_too_much_for_memory_gets_larger_voxels(monkeypatch, make_box, make_scene):
    from activestructure_gym.ground_truth import free_space

    room = make_scene(*make_box((0, 0, 0), (4, 3, 2.5)))  # 59 m2, 24,000 samples
    assert free_space.compute_free_space(room).voxel_size == pytest.approx(0.1)
    monkeypatch.setattr(voxelized_module, "MAX_SAMPLES", 10_000)
    assert 0.15 < free_space.compute_free_space(room).voxel_size < 0.18  # by hand: 0.1 * (2.4)^(1/2), in steps of 1.1
