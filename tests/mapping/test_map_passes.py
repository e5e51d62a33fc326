"""The compiled passes against the same conditions in numpy."""

import numpy as np
import pytest

from activestructure_gym.geometry import PinholeCamera, invert_rigid, look_along
from activestructure_gym.mapping.map_passes import CHUNK, MeasuredDepth, fit_to_stay, larger_in_view

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


def test_larger_in_view_is_what_projecting_says():
    rng = np.random.default_rng(1)
    parameters = _parameters(rng)
    camera = PinholeCamera(40, 30, 25.0, 27.0, 19.0, 16.0)
    pose = look_along(np.array([-1.0, 0.5, 0.2]), np.array([1.0, 0.2, -0.1]))
    depth = rng.uniform(0.5, 3.0, (30, 40)).astype(np.float32)
    depth[::3] = 0.0
    local = (parameters[:3, :COUNT].T.astype(np.float64) - pose[:3, 3]) @ pose[:3, :3]
    z = local[:, 2]
    u, v = camera.project(local).T
    inside = (z > 0) & (u >= 0) & (u < 40) & (v >= 0) & (v < 30)
    measured = np.zeros(COUNT)
    measured[inside] = depth[v[inside].astype(int), u[inside].astype(int)]
    sigma = np.exp(parameters[7:10, :COUNT].max(axis=0))
    middle = np.exp(np.median(parameters[7:10, :COUNT], axis=0))
    large = (sigma * 26.0 > 2.0 * z) | ((middle > 0.05) & (middle * 26.0 > z))
    expected = inside & (measured > 0) & large & (np.abs(z - measured) <= sigma)
    intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy], np.float32)
    to_camera = invert_rigid(pose)[:3].astype(np.float32)
    measured = MeasuredDepth(depth, to_camera, intrinsics)
    found, pixels = larger_in_view(parameters, COUNT, measured, 2.0, 0.05, 1.0, 1.0)
    assert expected.sum() > 10
    assert pixels.any() and not pixels[depth == 0].any()
    assert (found != expected).sum() <= 1  # float32 at a pixel's border


def test_only_chunks_that_changed_are_looked_at():
    parameters = np.zeros((14, 3 * CHUNK), np.float32)
    parameters[10] = -9.0  # nobody is opaque enough
    keep = fit_to_stay(parameters, 3 * CHUNK - 5, 0.0, 1.0, np.array([False, True, False]))
    assert keep[:CHUNK].all() and not keep[CHUNK : 2 * CHUNK].any() and keep[2 * CHUNK :].all()
