"""The compiled passes against the same conditions in numpy."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from activestructure_gym.geometry import PinholeCamera, invert_rigid, look_along
from activestructure_gym.mapping.map_passes import CHUNK, MeasuredDepth, too_wide, unfit

CAPACITY, COUNT = 3072, 2500  # more than one block, and not a whole number of them


def _parameters(rng):
    parameters = rng.normal(size=(14, CAPACITY)).astype(np.float32)
    parameters[:3] *= 2.0
    parameters[7:10] = rng.uniform(-6.0, -1.0, (3, CAPACITY))
    return parameters


def _everywhere(count):
    return np.ones(-(-count // CHUNK), dtype=bool)


@pytest.mark.parametrize("poison", [np.nan, np.inf, -np.inf])
def test_unfit_breaks_one_of_three_conditions(poison):
    rng = np.random.default_rng(0)
    parameters = _parameters(rng)
    rows, columns = rng.integers(14, size=60), rng.choice(COUNT, 60, replace=False)
    parameters[rows, columns] = poison
    live = parameters[:, :COUNT]
    expected = (live[10] >= -0.5) & (live[7:10] <= -1.5).all(axis=0) & np.isfinite(live).all(axis=0)
    np.testing.assert_array_equal(unfit(parameters, COUNT, -0.5, -1.5, _everywhere(COUNT)), np.flatnonzero(~expected))
    assert 100 < expected.sum() < COUNT - 100


def test_the_limits_themselves_may_stay():
    parameters = np.zeros((14, 16), np.float32)
    assert unfit(parameters, 3, 0.0, 0.0, _everywhere(3)).tolist() == []
    assert unfit(parameters, 3, np.nextafter(0.0, 1.0), 0.0, _everywhere(3)).tolist() == [0, 1, 2]
    assert unfit(parameters, 3, 0.0, np.nextafter(0.0, -1.0), _everywhere(3)).tolist() == [0, 1, 2]


def test_too_wide_is_what_projecting_says():
    rng = np.random.default_rng(1)
    parameters = _parameters(rng)
    parameters[7:10] += 2.0
    parameters[9, ::2] = parameters[7:9, ::2].max(axis=0)  # no disks: they have no back
    parameters[7, 1::2] = parameters[8, 1::2]  # round disks
    parameters[9, 1::2] = parameters[8, 1::2] - 1.0
    camera = PinholeCamera(40, 30, 25.0, 27.0, 19.0, 16.0)
    pose = look_along(np.array([-1.0, 0.5, 0.2]), np.array([1.0, 0.2, -0.1]))
    depth = rng.uniform(0.5, 3.0, (30, 40)).astype(np.float32)
    depth[::3] = 0.0
    largest = rng.uniform(0.02, 0.2, (30, 40)).astype(np.float32)
    means = parameters[:3, :COUNT].T.astype(np.float64)
    local = (means - pose[:3, 3]) @ pose[:3, :3]
    z = local[:, 2]
    u, v = camera.project(local).T
    inside = (z > 0) & (u >= 0) & (u < 40) & (v >= 0) & (v < 30)
    measured, limit = np.zeros(COUNT), np.zeros(COUNT)
    measured[inside] = depth[v[inside].astype(int), u[inside].astype(int)]
    limit[inside] = largest[v[inside].astype(int), u[inside].astype(int)]
    middle = np.exp(np.median(parameters[7:10, :COUNT], axis=0))
    on_surface = inside & (measured > 0) & (middle > limit) & (np.abs(z - measured) <= middle)
    normals = Rotation.from_quat(parameters[3:7, :COUNT].T, scalar_first=True).as_matrix()[:, :, 2]
    disk = parameters[9, :COUNT] < parameters[8, :COUNT]
    expected = on_surface & ~(disk & (np.einsum("ij,ij->i", normals, pose[:3, 3] - means) <= 0))
    assert expected.sum() > 10 and (on_surface & ~expected).sum() > 5
    intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy], np.float32)
    image = MeasuredDepth(depth, invert_rigid(pose)[:3].astype(np.float32), intrinsics)
    unseen = np.zeros(-(-COUNT // CHUNK), dtype=bool)
    found = too_wide(parameters, COUNT, unseen, image, largest)
    assert found.shape == (COUNT,) and (found != expected).sum() <= 1  # float32 at a pixel's border
    unseen[1] = True
    without = too_wide(parameters, COUNT, unseen, image, largest)
    assert not without[CHUNK : 2 * CHUNK].any() and found[CHUNK : 2 * CHUNK].any()
    assert np.array_equal(np.delete(without, slice(CHUNK, 2 * CHUNK)), np.delete(found, slice(CHUNK, 2 * CHUNK)))


def test_wide_ones_by_hand():
    """Wall at 2 m, f = 4, balls of a sigma of .6 m."""
    depth = np.full((6, 8), 2.0, np.float32)
    depth[0, 0] = 0.0  # looks along (-.875, -.625, 1)
    largest = np.full((6, 8), 0.59, np.float32)
    largest[3, 5:] = 0.61
    positions = [
        (0.1, 0.1, 2.0),  # on the wall, in pixel (3, 4)
        (0.6, 0.1, 2.0),  # in pixel (3, 5), which allows that much
        (0.1, 0.1, 2.5),  # half a metre behind it: within one sigma
        (0.1, 0.1, 2.7),  # behind it
        (0.1, 0.1, 1.3),  # in front of it
        (2.1, 0.1, 2.0),  # right of the image, which ends at x = 2
        (0.1, 0.1, -2.0),  # behind the camera
        (-1.75, -1.25, 2.0),  # where there is no return
    ]
    balls = np.zeros((14, len(positions)), np.float32)
    balls[:3], balls[3], balls[7:10] = np.array(positions).T, 1.0, np.log(0.6)
    image = MeasuredDepth(depth, np.eye(4, dtype=np.float32)[:3], np.array([4, 4, 4, 3], np.float32))
    nobody = np.zeros(1, dtype=bool)
    expected = [True, False, True, *[False] * 5]
    assert too_wide(balls, len(positions), nobody, image, largest).tolist() == expected
    # The middle one of the three sigmas decides: a disk is wide, a needle is not.
    balls[9] = np.log(0.01)
    balls[3:7] = np.array([[0.0, 1.0, 0.0, 0.0]]).T  # half a turn around x: its third axis is the camera's -z
    assert too_wide(balls, len(positions), nobody, image, largest).tolist() == expected
    balls[8] = np.log(0.02)
    assert not too_wide(balls, len(positions), nobody, image, largest).any()


def test_what_shows_its_back_is_another_surface():
    disk = np.zeros((14, 1), np.float32)
    disk[:3, 0], disk[3, 0], disk[7:9], disk[9] = (0.1, 0.1, 2.0), 1.0, np.log(0.6), np.log(0.06)  # normal: +z
    image = MeasuredDepth(
        np.full((6, 8), 2.0, np.float32), np.eye(4, dtype=np.float32)[:3], np.array([4, 4, 4, 3], np.float32)
    )
    largest = np.full((6, 8), 0.5, np.float32)
    assert not too_wide(disk, 1, np.zeros(1, dtype=bool), image, largest).any()
    disk[3:5, 0] = 0.0, 1.0
    assert too_wide(disk, 1, np.zeros(1, dtype=bool), image, largest).all()


def test_only_chunks_that_changed_are_looked_at():
    parameters = np.zeros((14, 3 * CHUNK), np.float32)
    parameters[10] = -9.0  # nobody is opaque enough
    found = unfit(parameters, 3 * CHUNK - 5, 0.0, 1.0, np.array([False, True, False]))
    np.testing.assert_array_equal(found, np.arange(CHUNK, 2 * CHUNK))
    assert len(unfit(parameters, 3 * CHUNK - 5, 0.0, 1.0, np.ones(3, bool))) == 3 * CHUNK - 5
