"""Rays through the volume visit exactly the voxels they cross, in order."""

from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.volume import FREE, OCCUPIED, PixelRays, VoxelVolume

BOUNDS = np.array([[0.0, 0.0, 0.0], [3.0, 2.0, 1.0]])
CAMERA = PinholeCamera.from_size(32, 18)
EYE = np.array([0.55, 1.05, 0.55])


def walled(x: float) -> VoxelVolume:
    """Free space up to a wall at ``x`` metres, unknown space behind it."""
    volume = VoxelVolume(BOUNDS)
    wall = volume.voxel_of(np.array([x, 0.0, 0.0]))[0]
    volume.state[:wall], volume.state[wall] = FREE, OCCUPIED
    return volume


def ahead(volume: VoxelVolume, **options: float) -> PixelRays:
    """The rays of a view along x, and of one that looks away from the wall."""
    poses = np.stack([look_along(EYE, np.array([sign, 0.0, 0.0])) for sign in (1.0, -1.0)])
    return volume.rays(CAMERA, poses, **options)  # type: ignore[arg-type]


def sampled(volume: VoxelVolume, rays: PixelRays, view: int, row: int, column: int) -> np.ndarray:
    """The voxels of one ray by samples 0.1 mm apart, in order, up to its end or the volume's border."""
    direction = rays.world_from_camera[view, :3, :3] @ rays.directions[row, column]
    points = EYE + np.arange(1e-5, rays.reach, 1e-4)[:, None] * direction
    voxels = volume.voxel_of(points[volume.contains(points)])
    return voxels[np.concatenate([[True], (np.diff(voxels, axis=0) != 0).any(axis=1)])]


def test_sums_are_those_of_the_sampled_voxels() -> None:
    volume, rng = VoxelVolume(BOUNDS), np.random.default_rng(0)
    values, passing = rng.random(volume.shape), rng.uniform(0.8, 1.0, volume.shape)
    rays = ahead(volume, reach=1.3, stride=4)
    plain, reached = rays.sums(values), rays.sums(values, passing)
    assert plain.shape == (2, 5, 8)
    for view, row, column in ((0, 0, 0), (0, 2, 5), (1, 3, 1), (1, 4, 7)):
        at = tuple(sampled(volume, rays, view, row, column).T)
        chance = np.cumprod(np.concatenate([[1.0], passing[at][:-1]]))
        assert plain[view, row, column] == pytest.approx(values[at].sum(), abs=1e-4)
        assert reached[view, row, column] == pytest.approx((values[at] * chance).sum(), abs=1e-4)


def test_rays_end_at_the_wall_at_their_reach_and_at_the_border() -> None:
    volume = walled(2.0)
    rays = ahead(volume)
    metres = rays.sums(volume.states != OCCUPIED, per_metre=True)
    wall = (2.0 - EYE[0]) / rays.directions[..., 2]
    across = rays.directions @ rays.world_from_camera[0, :3, :3].T
    inside = (np.abs(EYE + wall[..., None] * across - [1.5, 1.0, 0.5]) < [2.0, 1.0, 0.5]).all(axis=-1)
    assert inside.sum() > 50
    np.testing.assert_allclose(metres[0][inside], wall[inside], rtol=1e-5)
    assert rays.sums(volume.states == OCCUPIED)[0][inside].max() == 1.0  # the first occupied voxel counts, once
    np.testing.assert_allclose(ahead(volume, reach=0.4).sums(np.ones(volume.shape), per_metre=True)[0], 0.4, rtol=1e-5)
    backwards = ahead(volume).sums(np.ones(volume.shape), per_metre=True)[1]
    assert backwards.min() > 0.5 and backwards.max() < 1.0  # 0.55 m to the border, and its layer of one voxel
    assert not ahead(volume).sums(volume.unobserved)[0][inside].any()  # hidden by the wall


def test_what_is_seen_ends_with_the_first_occupied_voxel() -> None:
    volume = walled(2.0)
    seen = volume.rays(CAMERA, look_along(EYE, np.array([1.0, 0.0, 0.0])), stride=1).seen()
    wall = volume.voxel_of(np.array([2.0, 0.0, 0.0]))[0]
    eye = tuple(volume.voxel_of(EYE))
    assert seen[eye] and seen[wall].any() and not seen[wall + 1 :].any() and not seen[: eye[0]].any()
    both = ahead(volume, stride=1).seen()
    assert both[: eye[0]].any() and (both[eye[0] :] >= seen[eye[0] :]).all()


def test_no_view_and_a_view_from_outside() -> None:
    volume = walled(2.0)
    assert volume.rays(CAMERA, np.zeros((0, 4, 4))).sums(volume.occupied).shape == (0, 18, 32)
    outside = look_along(np.array([-1.0, 1.05, 0.55]), np.array([1.0, 0.0, 0.0]))
    middle = volume.rays(CAMERA, outside).sums(np.ones(volume.shape), per_metre=True)[0, 9, 16]
    assert middle == pytest.approx(2.2, abs=0.01)  # from the border, at -0.1 m, to the wall's far side


@pytest.mark.parametrize(
    "options",
    [
        {"reach": np.inf},
        {"reach": np.nan},
        {"reach": -1.0},
        {"reach": 0},
        {"stride": 0},
        {"stride": -2},
        {"stride": 1.5},
    ],
)
def test_a_reach_without_end_and_a_stride_below_one_are_refused(options: dict[str, float]) -> None:
    name, value = next(iter(options.items()))
    with pytest.raises(InputError, match=f"^{name} must be .*, or None, got {value}$"):
        ahead(VoxelVolume(BOUNDS), **options)


@pytest.mark.parametrize("shape", [(3, 3), (3, 4), (2, 3, 4), (16,), (1, 1, 4, 4)])
def test_poses_of_another_shape_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(InputError, match="world_from_camera is one pose"):
        VoxelVolume(BOUNDS).rays(CAMERA, np.zeros(shape))


@pytest.mark.parametrize(
    ("values", "passing", "wanted"),
    [
        (np.zeros(3), None, r"values must have one number per voxel, \(32, 22, 12\), got \(3,\)"),
        (np.zeros((32, 22, 12)), np.zeros(2), "passing must have one number per voxel"),
        (np.zeros((32, 22, 12)), np.full((32, 22, 12), 1.5), "passing must be in 0..1, got values from 1.5"),
        (np.zeros((32, 22, 12)), np.full((32, 22, 12), np.nan), "passing must be in 0..1"),
    ],
)
def test_wrong_arrays_are_refused_in_one_sentence(values: np.ndarray, passing: np.ndarray | None, wanted: str) -> None:
    with pytest.raises(InputError, match=wanted):
        ahead(VoxelVolume(BOUNDS)).sums(values, passing)
