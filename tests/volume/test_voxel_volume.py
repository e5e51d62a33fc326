import copy
import pickle

import numpy as np
import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.volume import FREE, OCCUPIED, UNKNOWN, VolumeConfig, VoxelVolume, distance_field

CAMERA = PinholeCamera.from_size(160, 90)
ROOM = np.array([[0.0, 0.0, 0.0], [4.0, 3.0, 2.5]])


def capture(caster, pose, camera=CAMERA, noise=None):
    rays = camera.rays().reshape(-1, 3) @ pose[:3, :3].T
    depth = caster.cast(pose[:3, 3], rays).distance.reshape(camera.height, camera.width)
    depth = np.where(np.isfinite(depth), depth, 0.0).astype(np.float32)
    if noise is not None:
        # Kinect (Nguyen 2012), axial, at incidence 0.
        sigma = 0.0012 + 0.0019 * (depth - 0.4) ** 2
        depth = np.where(depth > 0, np.maximum(depth + sigma * noise.normal(size=depth.shape), 0), 0).astype(np.float32)
    return Frame(np.zeros((*depth.shape, 3), np.uint8), depth, pose, camera)


def look_around(caster, volume, rng, count, lower=(0.6, 0.6, 0.6), upper=(3.4, 2.4, 1.9), noise=None):
    for _ in range(count):
        direction = rng.normal(size=3) * [1, 1, 0.5]
        volume.integrate(capture(caster, look_along(rng.uniform(lower, upper), direction), noise=noise))


@pytest.fixture(scope="module")
def room_volume(cast_boxes):
    volume = VoxelVolume(ROOM)
    look_around(cast_boxes(ROOM), volume, np.random.default_rng(0), 80)
    return volume


def room_clearance(points):
    """Distance to the nearest wall of the empty room."""
    return np.minimum(points - ROOM[0], ROOM[1] - points).min(axis=-1)


def cube_to_room_surface(volume):
    """Whether a voxel's cube touches or crosses the room's walls."""
    centers = volume.center_of(np.stack(np.indices(volume.shape), axis=-1))
    return room_clearance(centers) <= volume.voxel_size / 2 + 1e-9, room_clearance(centers) < -volume.voxel_size / 2


def test_grid_and_world_coordinates_agree():
    volume = VoxelVolume(np.array([[-1.0, 0.0, 2.0], [1.0, 1.05, 3.0]]), VolumeConfig(voxel_size=0.1))
    assert volume.shape == (22, 13, 12)  # one voxel more on each side; 1.05 m needs 11 voxels
    indices = np.array([[0, 0, 0], [21, 12, 11], [3, 4, 5]])
    np.testing.assert_array_equal(volume.voxel_of(volume.center_of(indices)), indices)
    assert volume.contains(np.array([[-1.0, 0.0, 2.0], [1.0, 1.05, 3.0]])).all()
    assert not volume.contains(np.array([[-1.2, 0.5, 2.5]]))[0]
    assert volume.state_at(np.array([[50.0, 0.0, 0.0]]))[0] == UNKNOWN


def test_no_voxel_with_surface_becomes_free_and_the_rest_does(room_volume):
    touching, outside = cube_to_room_surface(room_volume)
    assert not (room_volume.state == FREE)[touching | outside].any()
    assert (room_volume.state != OCCUPIED)[~touching].all()  # exact depth: hits lie on walls only
    # Everything more than two voxels from the walls was seen from 80 views.
    centers = room_volume.center_of(np.stack(np.indices(room_volume.shape), axis=-1))
    assert (room_volume.state[room_clearance(centers) > 0.2] == FREE).mean() > 0.98
    assert 0.6 < room_volume.observed_share < 1.0


def test_clearance_is_never_above_the_truth_by_more_than_the_slack(room_volume):
    # Walls lie in voxels that are not free: the stated clearance can only be too small, by the wall's voxel and the one
    # beside it (whose footprint is never clear of the wall).
    slack = room_volume.config.unknown_slack
    points = np.random.default_rng(1).uniform(ROOM[0] + 0.3, ROOM[1] - 0.3, size=(5000, 3))
    stated, true = room_volume.clearance_at(points), room_clearance(points)
    seen = stated > 0.05  # the few never seen corners aside
    assert seen.mean() > 0.97
    assert (stated <= true + slack + 1e-6).all()
    assert np.median((true - stated)[seen]) < 2 * room_volume.voxel_size


def test_kinect_noise_keeps_the_room_safe_and_open(cast_boxes):
    volume, rng = VoxelVolume(ROOM), np.random.default_rng(3)
    look_around(cast_boxes(ROOM), volume, rng, 120, noise=rng)
    touching, outside = cube_to_room_surface(volume)
    assert not (volume.state == FREE)[touching | outside].any()
    centers = volume.center_of(np.stack(np.indices(volume.shape), axis=-1))
    assert (volume.state[room_clearance(centers) > 0.3] == FREE).mean() > 0.97


def test_a_pixel_without_return_proves_nothing(cast_boxes):
    volume = VoxelVolume(ROOM)
    frame = capture(cast_boxes(ROOM), look_along(np.array([1.0, 1.5, 1.25]), np.array([1.0, 0.0, 0.0])))
    volume.integrate(Frame(frame.rgb, np.zeros_like(frame.depth), frame.world_from_camera, frame.camera))
    assert volume.observed_share == 0.0
    depth = frame.depth.copy()
    depth[:, 80] = 0.0
    volume.integrate(Frame(frame.rgb, depth, frame.world_from_camera, frame.camera))
    # Column 80 looks to y just below 1.5: voxels crossed by it stay unknown, those beside it are free.
    assert volume.state_at(np.array([[2.5, 1.47, 1.25]]))[0] != FREE
    assert volume.state_at(np.array([[2.5, 1.85, 1.25], [2.5, 1.15, 1.25]])).tolist() == [FREE, FREE]


def test_up_to_the_sensors_range_no_return_means_nothing_there(cast_boxes):
    # One wall at x = 8, the sensor reaches 5 m: nothing returns, yet the hall before the wall is free.
    caster, bounds = cast_boxes(([8.0, -9, -9], [8.1, 9, 9])), np.array([[0.0, -1.0, 0.0], [8.0, 1.0, 2.0]])
    frame = capture(caster, look_along(np.array([0.5, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])))
    frame.depth[frame.depth > 5.0] = 0.0
    volume = VoxelVolume(bounds)
    volume.integrate(frame)
    assert volume.observed_share == 0.0
    volume.integrate(frame, sensor_range=5.0)
    assert volume.state_at(np.array([[2.0, 0.0, 1.0], [2.5, 0.3, 1.2]])).tolist() == [FREE, FREE]
    assert (volume.weight == 0).all()  # no surface distance without a return


@pytest.mark.parametrize("width", [160, 960])  # of large images a part of the rays is enough
def test_voxels_on_rays_without_return_are_recorded_up_to_the_range_of_the_volume(width):
    camera, eye = PinholeCamera.from_size(width, width * 9 // 16), np.array([0.5, 1.0, 1.0])
    pose, volume = look_along(eye, np.array([1.0, 0.0, 0.0])), VoxelVolume(np.array([[0.0] * 3, [8.0, 2.0, 2.0]]))
    depth = np.full((camera.height, camera.width), 3.0, np.float32)
    depth[:, camera.width // 2 :] = 0.0  # towards y < 1
    frame = Frame(np.zeros((*depth.shape, 3), np.uint8), depth, pose, camera)
    volume.integrate(frame)
    assert not volume.no_return.any()  # the range is unknown
    volume.integrate(frame, sensor_range=6.0)
    x, y, z = volume.center_of(np.stack(np.indices(volume.shape), axis=-1)).transpose(3, 0, 1, 2)
    assert not volume.no_return[(x > 5.6) | (y > 1.1) | (x < 0.4)].any()  # 5 m
    assert volume.no_return[(x > 1.8) & (x < 4.5) & (y > 0.1) & (y < 0.9) & (abs(z - 1.0) < 0.4)].mean() > 0.99
    assert not volume.unobserved[volume.no_return].any()


@pytest.mark.parametrize("dropouts", [False, True])
def test_pixels_that_were_not_measured_prove_nothing_to_be_free(dropouts):
    # A hall of 8 m. The right half of the image sees no surface within 5 m; of these pixels a block and single ones
    # were not measured.
    camera, pose = PinholeCamera.from_size(160, 90), look_along(np.array([0.5, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]))
    depth = np.full((90, 160), 3.0, np.float32)
    depth[:, 80:] = 0.0
    unmeasured = np.zeros(depth.shape, bool)
    unmeasured[20:70, 100:150] = True
    unmeasured[::7, :80:7] = True  # on the wall of the left half
    depth[unmeasured] = 0.0
    bounds = np.array([[0.0, -2.0, 0.0], [8.0, 2.0, 2.0]])
    volumes = [VoxelVolume(bounds), VoxelVolume(bounds)]
    for volume, marked in zip(volumes, (unmeasured, None)):
        frame = Frame(np.zeros((90, 160, 3), np.uint8), depth, pose, camera, marked)
        volume.integrate(frame, sensor_range=5.0, dropouts=dropouts)
    x, y, z = volumes[0].center_of(np.stack(np.indices(volumes[0].shape), axis=-1)).transpose(3, 0, 1, 2)
    column, row = 80 - 80 * y / np.maximum(x - 0.5, 0.1), 45 - 80 * (z - 1.0) / np.maximum(x - 0.5, 0.1)
    inside = (column > 108) & (column < 142) & (row > 28) & (row < 62) & (x > 1.2) & (x < 2.2)
    assert inside.sum() > 50
    assert (volumes[0].state[inside] == UNKNOWN).all() and (volumes[1].state[inside] == FREE).mean() > 0.2
    assert volumes[0].no_return[inside].mean() > 0.9  # a window or a dark object: no planner waits for it
    behind = (x > 3.8) & (y > 0.3)  # beyond the wall, on rays of single lost pixels
    assert not volumes[0].no_return[behind].any() and not (volumes[0].state[behind] == FREE).any()


@pytest.mark.parametrize("share", ["block", "most"])
def test_rays_of_unmeasured_pixels_end_at_a_known_wall_and_count_in_no_blank_image(share):
    # A wall at x = 2.5 m, then an image of it with a block that was not measured, or with little that was.
    camera, pose = PinholeCamera.from_size(160, 90), look_along(np.array([0.5, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]))
    volume = VoxelVolume(np.array([[0.0, -2.0, 0.0], [6.0, 2.0, 2.0]]))
    rgb, depth = np.zeros((90, 160, 3), np.uint8), np.full((90, 160), 2.0, np.float32)
    volume.integrate(Frame(rgb, depth, pose, camera), sensor_range=5.0)
    volume.integrate(Frame(rgb, depth, pose, camera), sensor_range=5.0)
    depth[5:85, 20 : 140 if share == "most" else 80] = np.nan
    volume.integrate(Frame(rgb, depth, pose, camera), sensor_range=5.0)
    x = volume.center_of(np.stack(np.indices(volume.shape), axis=-1))[..., 0]
    before = (x < 2.4) & (volume.state == FREE)
    assert before.sum() > 1000 and not volume.no_return[x > 2.6].any()
    assert volume.no_return[before].any() == (share == "block")
    fresh = VoxelVolume(np.array([[0.0, -2.0, 0.0], [6.0, 2.0, 2.0]]))
    fresh.integrate(Frame(rgb, np.full_like(depth, np.nan), pose, camera), sensor_range=5.0)
    assert (fresh.state == UNKNOWN).all() and not fresh.no_return.any()


def test_a_wall_just_beyond_the_sensors_range_is_not_recorded_as_without_return(cast_boxes):
    caster, volume = cast_boxes(ROOM), VoxelVolume(ROOM)
    for x in (0.96, 1.5):  # the wall at x = 4 is 3.04 m away, then 2.5 m
        frame = capture(caster, look_along(np.array([x, 1.5, 1.25]), np.array([1.0, 0.0, 0.0])))
        frame.depth[frame.depth > 3.0] = 0.0
        volume.integrate(frame, sensor_range=3.0)
    assert volume.no_return.any() and volume.occupied.any()
    assert not (volume.no_return & volume.occupied).any()
    volume.integrate(frame, sensor_range=0.1)  # shorter than a voxel's diagonal


def test_single_lost_returns_are_no_rays_without_return(cast_boxes):
    frame = capture(cast_boxes(ROOM), look_along(np.array([1.0, 1.5, 1.25]), np.array([1.0, 0.0, 0.0])))
    frame.depth[::9, ::9] = 0.0
    volume = VoxelVolume(ROOM)
    volume.integrate(frame, sensor_range=10.0, dropouts=True)
    assert not volume.no_return.any()
    frame.depth[30:50, 30:50] = 0.0
    volume.integrate(frame, sensor_range=10.0, dropouts=True)
    assert volume.no_return.any()


def test_a_seam_between_two_views_is_pieced_together(cast_boxes):
    # Two level views 86 degrees apart overlap by 4 degrees: at 1.5 m that is 10 cm, less than a voxel is wide. No view
    # sees the seam's voxels whole, together they see all of them.
    caster, center = cast_boxes(([-4, -4, 0], [4, 4, 2.6])), np.array([0.0, 0.0, 1.3])
    volume = VoxelVolume(np.array([[-4.0, -4.0, 0.0], [4.0, 4.0, 2.6]]))
    yaws = np.radians([3.0, 89.0])
    alone = []
    for yaw in yaws:
        single = VoxelVolume(np.array([[-4.0, -4.0, 0.0], [4.0, 4.0, 2.6]]))
        for view in (volume, single):
            view.integrate(capture(caster, look_along(center, np.array([np.cos(yaw), np.sin(yaw), 0.0]))))
        alone.append(single.state == FREE)
    pieced = volume.center_of(np.argwhere((volume.state == FREE) & ~alone[0] & ~alone[1]))
    assert len(pieced) > 20
    bearing = np.degrees(np.arctan2(pieced[:, 1] - center[1], pieced[:, 0] - center[0]))
    distance = np.linalg.norm(pieced - center, axis=1)
    # Frustum edges at 48 and 44 degrees; a voxel is 0.07 m / distance wide to each side.
    assert (np.abs(bearing - 46.0) < 2.0 + np.degrees(0.09 / distance)).all()
    bearings = np.radians(np.arange(20, 70, 2))
    across = center + np.stack([np.cos(bearings), np.sin(bearings), np.zeros_like(bearings)], axis=1)
    assert (volume.state_at(across) == FREE).all()


def test_lost_returns_do_not_close_the_space(cast_boxes):
    caster, rng = cast_boxes(ROOM), np.random.default_rng(2)
    counts = []
    for dropouts in (True, False):
        volume = VoxelVolume(ROOM)
        for yaw in range(0, 360, 20):
            direction = np.array([np.cos(np.radians(yaw)), np.sin(np.radians(yaw)), 0.0])
            frame = capture(caster, look_along(np.array([2.0, 1.5, 1.25]), direction))
            frame.depth[rng.random(frame.depth.shape) < 0.05] = 0.0
            volume.integrate(frame, dropouts=dropouts)
        touching, outside = cube_to_room_surface(volume)
        assert not (volume.state == FREE)[touching | outside].any()
        counts.append(int((volume.state == FREE).sum()))
    assert counts[0] > 5 * counts[1]


def test_what_is_behind_a_surface_or_out_of_range_stays_unknown(cast_boxes):
    caster = cast_boxes(([-1, -1, 0], [9, 4, 2.5]), ([2.04, 1.0, 0.0], [2.2, 2.0, 2.5]))
    volume = VoxelVolume(np.array([[-1.0, -1.0, 0.0], [9.0, 4.0, 2.5]]), VolumeConfig(max_range=4.0))
    volume.integrate(capture(caster, look_along(np.array([0.5, 1.5, 1.2]), np.array([1.0, 0.0, 0.0]))))
    assert volume.state_at(np.array([[1.5, 1.5, 1.2], [2.06, 1.5, 1.2], [2.6, 1.5, 1.2]])).tolist() == [
        FREE,
        OCCUPIED,
        UNKNOWN,
    ]
    assert (volume.state[volume.voxel_of(np.array([4.8, 0.0, 0.0]))[0] :] == UNKNOWN).all()


def test_thin_pole_is_never_free_however_it_falls_between_the_rays(cast_boxes):
    rng = np.random.default_rng(5)
    for _ in range(30):
        x, y = rng.uniform([2.8, 1.2], [3.4, 1.8])
        caster = cast_boxes(([0, 0, 0], [6, 3, 2.5]), ([x - 0.015, y - 0.015, 0], [x + 0.015, y + 0.015, 2.5]))
        volume = VoxelVolume(np.array([[0.0, 0.0, 0.0], [6.0, 3.0, 2.5]]), VolumeConfig(max_miss_chance=0.0))
        for _ in range(10):
            direction = np.array([1.0, rng.normal() * 0.3, rng.normal() * 0.2])
            volume.integrate(capture(caster, look_along(np.array([0.7, 1.5, 1.2]), direction)))
        heights = np.arange(0.05, 2.5, 0.05)
        on_pole = np.stack([np.full_like(heights, x), np.full_like(heights, y), heights], axis=1)
        assert (volume.state_at(on_pole) != FREE).all()


def test_far_looks_need_to_agree(cast_boxes):
    # f = 80: at 4 m rays are 5 cm apart, a 3 cm pole is met with chance 0.6, so ceil(log 0.05 / log 0.4) = 4 looks.
    caster, volume = cast_boxes(([-5, -5, 0], [5, 5, 2.5])), VoxelVolume(np.array([[-5.0, -5.0, 0.0], [5.0, 5.0, 2.5]]))
    far, near = np.array([[3.95, 0.0, 1.2]]), np.array([[2.0, 0.0, 1.2]])
    states = []
    for n in range(5):
        pose = look_along(np.array([0.0, 0.0, 1.2]), np.array([1.0, 0.03 * n, 0.0]))
        volume.integrate(capture(caster, pose))
        states.append(int(volume.state_at(far)[0]))
        assert volume.state_at(near)[0] == FREE
        volume.integrate(capture(caster, pose))  # the same rays again say nothing new
    assert states == [UNKNOWN, UNKNOWN, UNKNOWN, FREE, FREE]


def test_a_wrong_hit_clears_after_enough_sure_looks_and_a_true_one_never(cast_boxes):
    caster, volume = cast_boxes(ROOM), VoxelVolume(ROOM)
    pose = look_along(np.array([0.6, 1.5, 1.25]), np.array([1.0, 0.0, 0.0]))
    wrong = capture(caster, pose)
    wrong.depth[45, 80] = 1.5
    volume.integrate(wrong)
    spot = np.array([[2.1, 1.49, 1.24]])
    assert volume.state_at(spot)[0] == OCCUPIED
    states = []
    for n in range(6):
        volume.integrate(capture(caster, look_along(np.array([0.6, 1.5, 1.25]), np.array([1.0, 0.05 * (n + 1), 0.0]))))
        states.append(int(volume.state_at(spot)[0]))
    assert states[:4] == [OCCUPIED] * 4 and states[4:] == [FREE] * 2


def test_sphere_of_the_body_is_free_inside_only():
    volume = VoxelVolume(ROOM)
    center = np.array([2.0, 1.5, 1.25])
    volume.mark_free_sphere(center, 0.45)
    free = volume.center_of(np.argwhere(volume.state == FREE))
    assert len(free) > 100
    assert (np.linalg.norm(np.abs(free - center) + 0.05, axis=1) <= 0.45 + 1e-9).all()
    # The nearest cube that sticks out of the sphere comes at most its diagonal (0.17 m) closer.
    assert 0.25 < volume.clearance_at(center[None])[0] <= 0.45
    volume.mark_free_sphere(np.array([-9.0, 0.0, 0.0]), 0.45)  # beyond the grid: nothing to do


def test_unknown_space_counts_as_set_back_by_the_slack():
    for slack in (0.0, 0.05):
        volume = VoxelVolume(ROOM, VolumeConfig(unknown_slack=slack))
        volume.state[1:-1, 1:-1, 1:-1] = FREE
        inner = np.array([20, 15, 12])
        volume.state[23, 15, 12] = UNKNOWN
        volume.state[20, 17, 12] = OCCUPIED
        # Cubes 3 and 2 voxels away: 0.25 m and 0.15 m to their faces.
        assert volume.clearance[20, 15, 12] == pytest.approx(0.15, abs=1e-6)
        volume.state[20, 17, 12] = FREE
        volume._changed()
        assert volume.clearance[tuple(inner)] == pytest.approx(0.25 + slack, abs=1e-6)
        assert volume.clearance[23, 15, 12] == 0.0
        # The shell of the grid is unknown here: one row inside it is half a voxel from it.
        assert volume.clearance[1, 15, 12] == pytest.approx(0.05 + slack, abs=1e-6)


def test_clearance_equals_plain_distances_on_random_states():
    rng = np.random.default_rng(9)
    volume = VoxelVolume(np.array([[0.0, 0.0, 0.0], [1.2, 0.9, 0.7]]), VolumeConfig(unknown_slack=0.12))
    volume.state[:] = rng.choice([UNKNOWN, FREE, OCCUPIED], p=[0.02, 0.96, 0.02], size=volume.shape)
    volume.state[:3] = UNKNOWN  # the free box does not fill the grid
    padded = np.pad(volume.state, 1, constant_values=UNKNOWN)
    cubes, kinds = np.argwhere(padded != FREE) - 1, padded[padded != FREE]
    for voxel in np.argwhere(volume.state == FREE)[::17]:
        gaps = np.maximum(np.abs(cubes - voxel) - 0.5, 0.0)
        distance = 0.1 * np.linalg.norm(gaps, axis=1) + np.where(kinds == UNKNOWN, 0.12, 0.0)
        assert volume.clearance[tuple(voxel)] == pytest.approx(distance.min(), abs=1e-5)


@pytest.mark.parametrize("slack", [0.0, 0.12, 0.3])
def test_clearance_around_some_points_is_the_whole_ones_as_far_as_it_is_asked(slack):
    rng = np.random.default_rng(4)
    for share in (0.002, 0.01, 0.05):
        volume = VoxelVolume(np.array([[0.0, 0.0, 0.0], [2.4, 1.9, 1.3]]), VolumeConfig(unknown_slack=slack))
        kinds = [UNKNOWN, FREE, OCCUPIED]
        volume.state[:] = rng.choice(kinds, p=[share, 1 - 2 * share, share], size=volume.shape)
        everywhere = copy.copy(volume).clearance
        points = rng.uniform(-1.0, volume.shape, size=(40, 3))  # some beyond the grid
        for enough in (0.1, 0.157, 0.2):
            for ends in points.reshape(-1, 2, 3):
                between = rng.uniform(ends.min(axis=0), ends.max(axis=0), size=(60, 3))
                field = volume.clearance_around(ends, enough=enough)
                found = distance_field.sample_points(field, between)
                whole = distance_field.sample_points(everywhere, between)
                low = whole < np.float32(enough)
                np.testing.assert_array_equal(found[low], whole[low])
                assert (found[~low] >= np.float32(enough)).all()
        assert volume.clearance_around(points, enough=0.2) is not volume.clearance_around(points, enough=0.2)
        whole = volume.clearance
        assert volume.clearance_around(points, enough=0.2) is whole  # measured already: nothing to do


def test_tsdf_vanishes_on_the_wall(room_volume):
    # Along x through the middle of the room: the zero of the interpolated TSDF lies at the wall, x = 4.
    voxels = room_volume.voxel_of(np.array([[3.0, 1.5, 1.25], [4.05, 1.5, 1.25]]))
    line = slice(voxels[0, 0], voxels[1, 0] + 1), voxels[0, 1], voxels[0, 2]
    values, weights = room_volume.tsdf[line], room_volume.weight[line]
    assert (weights > 0).all()
    x = room_volume.center_of(np.stack([np.arange(*line[0].indices(999)), *[np.zeros(len(values))] * 2], axis=1))[:, 0]
    crossing = np.flatnonzero((values[:-1] > 0) & (values[1:] <= 0))
    assert len(crossing) == 1
    n = crossing[0]
    zero = x[n] + (x[n + 1] - x[n]) * values[n] / (values[n] - values[n + 1])
    # Oblique views shorten projective distances unevenly on the two sides: a third of a voxel.
    assert zero == pytest.approx(4.0, abs=0.035)


def test_integration_is_deterministic_and_survives_pickling(cast_boxes):
    caster, volumes = cast_boxes(ROOM), []
    for _ in range(2):
        volume = VoxelVolume(ROOM)
        look_around(caster, volume, np.random.default_rng(7), 5)
        volumes.append(pickle.loads(pickle.dumps(volume)))
    np.testing.assert_array_equal(volumes[0].state, volumes[1].state)
    np.testing.assert_array_equal(volumes[0].tsdf, volumes[1].tsdf)
    look_around(caster, volumes[0], np.random.default_rng(8), 2)
    assert volumes[0].observed_share > volumes[1].observed_share


def test_sight_ends_at_what_is_occupied(room_volume):
    inside = np.array([2.0, 1.5, 1.25])
    wall, behind = np.array([[4.0, 1.6, 1.2]]), np.array([[4.6, 1.6, 1.2]])
    assert room_volume.line_of_sight_free(inside, wall)[0]
    assert not room_volume.line_of_sight_free(inside, behind)[0]
    empty = VoxelVolume(ROOM)
    assert empty.line_of_sight_free(inside, wall)[0]  # unknown space hides nothing


def test_wrong_input_is_refused(cast_boxes):
    with pytest.raises(InputError, match="units"):
        VoxelVolume(np.array([[0.0, 0.0, 0.0], [8000.0, 6000.0, 2500.0]]))
    with pytest.raises(ValueError, match="upper above lower"):
        VoxelVolume(ROOM[::-1])
    with pytest.raises(ValueError, match="voxel_size"):
        VolumeConfig(voxel_size=0.0)
    with pytest.raises(ValueError, match="hit_gain"):
        VolumeConfig(hit_gain=0)
    frame = capture(cast_boxes(ROOM), look_along(np.array([1.0, 1.5, 1.25]), np.array([1.0, 0.0, 0.0])))
    with pytest.raises(ValueError, match="camera"):
        VoxelVolume(ROOM).integrate(Frame(frame.rgb, frame.depth[:10], frame.world_from_camera, CAMERA))


def test_unobserved_is_what_no_ray_went_through() -> None:
    volume = VoxelVolume(np.array([[0.0] * 3, [1.0] * 3]))
    assert volume.unobserved.all()
    cases = [  # state, observations, signed distance -> unobserved
        (UNKNOWN, 1.0, 0.3, False),  # in front of a surface, not proven free
        (UNKNOWN, 1.0, -0.3, True),  # behind it
        (UNKNOWN, 0.0, 0.3, True),  # the distance says nothing
        (FREE, 0.0, 0.0, False),
        (OCCUPIED, 1.0, -0.3, False),
    ]
    for row, (state, weight, tsdf, _) in enumerate(cases):
        volume.state[row, 0, 0], volume.weight[row, 0, 0], volume.tsdf[row, 0, 0] = state, weight, tsdf
    assert volume.unobserved[: len(cases), 0, 0].tolist() == [expected for *_, expected in cases]


def test_a_scene_that_no_run_could_be_read_of_is_refused():
    bounds = np.array([[4_999_997.0, 0.0, 0.0], [5_000_003.0, 5.0, 3.0]])
    with pytest.raises(InputError, match="is 5,000,003 m from the origin, and at most 1,000,000 m is allowed"):
        VoxelVolume(bounds)
