"""The compiled passes against the same conditions in numpy."""

import numpy as np
import pytest

from activestructure_gym.geometry import PinholeCamera, invert_rigid, look_along
from activestructure_gym.mapping.map_passes import CHUNK, MeasuredDepth, fit_to_stay, too_wide

CAPACITY, COUNT = 3072, 2500  # more than one block, and not a whole number of them


def _parameters(rng):
    parameters = rng.normal(size=(14, CAPACITY)).astype(np.float32)
    parameters[:3] *= 2.0
    parameters[7:10] = rng.uniform(-6.0, -1.0, (3, CAPACITY))
    return parameters


def _everywhere(count):
    return np.ones(-(-count // CHUNK), dtype=bool)


@pytest.mark.parametrize("poison", [np.nan, np.inf, -np.inf])
def test_fit_to_stay_is_three_conditions(poison):
    rng = np.random.default_rng(0)
    parameters = _parameters(rng)
    rows, columns = rng.integers(14, size=60), rng.choice(COUNT, 60, replace=False)
    parameters[rows, columns] = poison
    live = parameters[:, :COUNT]
    expected = (live[10] >= -0.5) & (live[7:10] <= -1.5).all(axis=0) & np.isfinite(live).all(axis=0)
    assert np.array_equal(fit_to_stay(parameters, COUNT, -0.5, -1.5, _everywhere(COUNT)), expected)
    assert 100 < expected.sum() < COUNT - 100


def test_the_limits_themselves_may_stay():
    parameters = np.zeros((14, 16), np.float32)
    assert fit_to_stay(parameters, 3, 0.0, 0.0, _everywhere(3)).tolist() == [True] * 3
    assert not fit_to_stay(parameters, 3, np.nextafter(0.0, 1.0), 0.0, _everywhere(3)).any()
    assert not fit_to_stay(parameters, 3, 0.0, np.nextafter(0.0, -1.0), _everywhere(3)).any()


def test_too_wide_is_what_projecting_says():
    rng = np.random.default_rng(1)
    parameters = _parameters(rng)
    camera = PinholeCamera(40, 30, 25.0, 27.0, 19.0, 16.0)
    pose = look_along(np.array([-1.0, 0.5, 0.2]), np.array([1.0, 0.2, -0.1]))
    parameters[7:10] += 1.0
    depth = rng.uniform(0.5, 3.0, (30, 40)).astype(np.float32)
    depth[::3] = 0.0
    local = (parameters[:3, :COUNT].T.astype(np.float64) - pose[:3, 3]) @ pose[:3, :3]
    z = local[:, 2]
    u, v = camera.project(local).T
    inside = (z > 0) & (u >= 0) & (u < 40) & (v >= 0) & (v < 30)
    measured = np.zeros(COUNT)
    measured[inside] = depth[v[inside].astype(int), u[inside].astype(int)]
    middle = np.exp(np.median(parameters[7:10, :COUNT], axis=0))
    largest = rng.uniform(0.01, 0.1, (30, 40)).astype(np.float32)
    allowed = np.full(COUNT, np.inf)
    allowed[inside] = largest[v[inside].astype(int), u[inside].astype(int)]
    expected = inside & (measured > 0) & (middle > allowed) & (np.abs(z - measured) <= middle)
    intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy], np.float32)
    to_camera = invert_rigid(pose)[:3].astype(np.float32)
    chunks = np.zeros(-(-COUNT // CHUNK), bool)
    found = too_wide(parameters, COUNT, chunks, MeasuredDepth(depth, to_camera, intrinsics), largest)
    assert expected.sum() > 10
    assert (found != expected).sum() <= 1  # float32 at a pixel's border
    assert not too_wide(parameters, COUNT, ~chunks, MeasuredDepth(depth, to_camera, intrinsics), largest).any()


def test_only_chunks_that_changed_are_looked_at():
    parameters = np.zeros((14, 3 * CHUNK), np.float32)
    parameters[10] = -9.0  # nobody is opaque enough
    keep = fit_to_stay(parameters, 3 * CHUNK - 5, 0.0, 1.0, np.array([False, True, False]))
    assert keep[:CHUNK].all() and not keep[CHUNK : 2 * CHUNK].any() and keep[2 * CHUNK :].all()


def test_too_wide_by_hand():
    """Wall at 2 m, f = 4: what is on it within one sigma and wider than its pixel allows goes, by the middle sigma."""
    camera = PinholeCamera.from_size(8, 6)
    depth = np.full((6, 8), 2.0, np.float32)
    depth[0, 0] = 0.0  # looks along (-.875, -.625, 1)
    measured = MeasuredDepth(
        depth, np.eye(4, dtype=np.float32)[:3], np.array([camera.fx, camera.fy, camera.cx, camera.cy], np.float32)
    )
    positions = [
        (0.1, 0.1, 2.0),  # on the wall
        (0.1, 0.1, 2.5),  # half a metre behind it: within one sigma
        (0.1, 0.1, 2.7),  # behind it
        (0.1, 0.1, 1.3),  # in front of it
        (2.1, 0.1, 2.0),  # right of the image, which ends at x = 2
        (0.1, 0.1, -2.0),  # behind the camera
        (-1.75, -1.25, 2.0),  # where there is no return
        (0.1, 0.1, 2.0),  # a needle
    ]
    balls = np.zeros((14, 16), np.float32)
    balls[:3, : len(positions)] = np.array(positions).T
    balls[7:10] = np.log(0.6)
    balls[[7, 9], 7] = np.log(0.01)
    for allowed, expected in ((0.59, [True, True, *[False] * 6]), (0.61, [False] * 8)):
        largest = np.full((6, 8), allowed, np.float32)
        assert too_wide(balls, 8, np.zeros(1, bool), measured, largest).tolist() == expected
