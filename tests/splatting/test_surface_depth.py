"""Depth of the surface that a map shows: by hand, against planes, and against a search along the rays."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation

from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.splatting import cpu
from activestructure_gym.splatting.surface_depth import surface_depth

CAMERA = PinholeCamera.from_size(48, 36)


def disks(points: np.ndarray, turn: Rotation, sigma: tuple[float, float, float], opacity: float = 0.99) -> np.ndarray:
    block = np.zeros((14, len(points)), np.float32)
    block[:3] = points.T
    block[3:7] = turn.as_quat(scalar_first=True)[:, None]
    block[7:10] = np.log(sigma)[:, None]
    block[10] = np.log(opacity / (1 - opacity))
    block[11:] = 0.5
    return block


def wall(slant: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Disks on a plane 3 m ahead, turned by ``slant`` about the vertical; the plane's point and normal."""
    turn = Rotation.from_euler("y", slant)
    a, b = np.mgrid[-4:4:0.1, -3:3:0.1]
    points = turn.apply(np.stack([a.ravel(), b.ravel(), np.zeros(a.size)], axis=1)) + [0, 0, 3]
    return disks(points, turn, (0.09, 0.09, 0.002)), np.array([0, 0, 3.0]), turn.apply([0, 0, 1.0])


@pytest.mark.parametrize("slant", [0.0, 0.5, 1.0])
def test_a_plane_of_disks_has_the_depth_of_the_plane(slant: float) -> None:
    block, point, normal = wall(slant)
    found = surface_depth(block, block.shape[1], CAMERA, np.eye(4)[None])[0]
    rays = CAMERA.rays()
    exact = (point @ normal) / (rays @ normal)
    mean, of_centres = (
        cpu.render(block, block.shape[1], CAMERA, np.eye(4), centre_depth=centre) for centre in (False, True)
    )
    inner = (mean.alpha > 0.999) & (exact < 4.0)
    assert inner.mean() > 0.3 and np.abs(found - exact)[inner].max() < 2e-3
    off, off_by_centres = ((one.depth[inner] / one.alpha[inner] - exact[inner]).mean() for one in (mean, of_centres))
    if slant:  # depths of centres are not the surface's: of disks that overlap the nearer come first
        assert off_by_centres < -0.05 and abs(off) < 0.2 * abs(off_by_centres)


def test_beside_an_edge_it_is_one_surface_or_the_other() -> None:
    block, _, _ = wall(0.0)
    before = disks(np.array([[0.0, 0.0, 1.5]]), Rotation.identity(), (0.2, 0.2, 0.01))
    both = np.concatenate([before, block], axis=1)
    found = surface_depth(both, both.shape[1], CAMERA, np.eye(4)[None])[0]
    near = np.minimum(np.abs(found - 1.5), np.abs(found - 3.0))
    assert near.max() < 0.02 and (found < 2).any() and (found > 2).any()
    mixed = cpu.render(both, both.shape[1], CAMERA, np.eye(4))
    expected = mixed.depth / mixed.alpha
    assert np.minimum(np.abs(expected - 1.5), np.abs(expected - 3.0)).max() > 0.3


def test_nothing_is_0_and_half_transparent_is_nothing() -> None:
    weak = disks(np.array([[0.0, 0.0, 2.0]]), Rotation.identity(), (1.0, 1.0, 0.1), opacity=0.45)
    assert not surface_depth(weak, 1, CAMERA, np.eye(4)[None]).any()
    assert not surface_depth(np.zeros((14, 16), np.float32), 0, CAMERA, np.eye(4)[None]).any()
    assert surface_depth(weak, 1, CAMERA, np.zeros((0, 4, 4))).shape == (0, 36, 48)


def test_the_place_on_a_ray_is_where_the_gaussian_is_densest() -> None:
    rng = np.random.default_rng(0)
    pose = look_along(np.array([0.3, -0.2, 0.1]), np.array([0.2, 1.0, 0.1]))
    for _ in range(5):
        turn = Rotation.random(rng=rng)
        sigma = tuple(rng.uniform(0.05, 0.5, 3))
        block = disks(np.array([[0.5, 2.5, 0.3]]), turn, sigma)
        found = surface_depth(block, 1, CAMERA, pose[None])[0]
        row, column = np.argwhere(found > 0)[3]
        ray = pose[:3, :3] @ CAMERA.rays()[row, column]

        whitened = [turn.inv().apply(part) / sigma for part in (pose[:3, 3] - block[:3, 0], ray)]
        best = minimize_scalar(
            lambda depth, start, along: np.sum((start + depth * along) ** 2), args=tuple(whitened),
            bounds=(0.1, 10), method="bounded", options={"xatol": 1e-9},
        ).x  # fmt: skip
        assert found[row, column] == pytest.approx(best, abs=1e-4)


@pytest.mark.parametrize(("sigma", "end"), [(0.1, 0.02), (2.0, 1.44)])
def test_beyond_the_end_of_a_disk_next_to_the_camera_its_centre_counts(sigma: float, end: float) -> None:
    """A disk 3 cm to the right of the camera covers its half of the image. Column 24 meets its plane at 1.44 m."""
    turn = Rotation.from_euler("y", 90.0, degrees=True)
    block = disks(np.array([[0.03, 0.0, 0.02]]), turn, (sigma, sigma, 4e-4))
    found = surface_depth(block, 1, CAMERA, np.eye(4)[None])[0, CAMERA.height // 2]
    np.testing.assert_allclose(found[25:28], 0.03 / CAMERA.rays()[0, 25:28, 0], rtol=0.01)
    np.testing.assert_allclose(found[24], end, rtol=0.01)
