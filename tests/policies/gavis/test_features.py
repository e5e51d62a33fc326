"""GAVIS: visibility against spherical harmonics and by hand, and which views it finds uncertain."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import sph_harm_y, spherical_in

from activestructure_gym.features import evaluate_features
from activestructure_gym.geometry import look_along
from activestructure_gym.policies.gavis.features import (
    KAPPA,
    ViewMoments,
    degree_factors,
    excess_entropy,
    near_factor,
    virtual_gaussians,
    visibility,
    with_virtual,
)
from activestructure_gym.volume import FREE, UNKNOWN


def seen_from(looks_at: list[np.ndarray], keyframes: int, eye: np.ndarray) -> float:
    """Visibility of a Gaussian at the origin, from ``eye``, after looks from these unit directions."""
    v = np.array(looks_at).reshape(-1, 3)
    products = (v[:, :, None] * v[:, None, :]).sum(axis=0)[np.triu_indices(3)]
    number, factors = np.array([float(len(v))]), degree_factors(KAPPA)
    moments = ViewMoments(number, v.sum(axis=0)[None], products[None], keyframes, factors)
    result = np.zeros(1, np.float32)
    visibility(np.zeros((14, 16), np.float32), 1, np.ones(1, bool), eye.astype(float), moments, result)
    return float(result[0])


def by_harmonics(looks_at: np.ndarray, keyframes: int, direction: np.ndarray) -> float:
    """The paper's coefficients, 4 pi zeta i_l(kappa) sum of Y_lm(d_p)*, put into the series and the bound."""

    def angles(d):
        return np.arccos(d[..., 2]), np.arctan2(d[..., 1], d[..., 0])

    total = 0.0
    for degree in range(3):
        for order in range(-degree, degree + 1):
            sums = np.conj(sph_harm_y(degree, order, *angles(looks_at))).sum()
            coefficient = 4.0 * np.pi * np.exp(-KAPPA) * spherical_in(degree, KAPPA) * sums
            total += (coefficient * sph_harm_y(degree, order, *angles(direction))).real
    return 1.0 - (1.0 - np.clip(total / keyframes, 0.0, 1.0)) ** keyframes


def test_visibility_is_the_series_of_spherical_harmonics(rng: np.random.Generator) -> None:
    for number in (1, 2, 7):
        directions = rng.normal(size=(number + 1, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        found = seen_from(list(directions[1:]), 9, 2.0 * directions[0])
        assert found == pytest.approx(by_harmonics(directions[1:], 9, directions[0]), abs=1e-6)


def test_the_series_to_degree_2_is_near_the_exponential_and_sums_up_to_it() -> None:
    cosine = np.linspace(-1.0, 1.0, 21)
    zero, one, two = degree_factors(KAPPA)
    series = zero + one * cosine + two * 0.5 * (3.0 * cosine**2 - 1.0)
    assert np.abs(series - np.exp(KAPPA * (cosine - 1.0))).max() < 0.13
    assert degree_factors(1e-3) == pytest.approx([1.0, 0.0, 0.0], abs=2e-3)


def test_one_side_of_a_wall_tells_little_of_the_other() -> None:
    front = np.array([1.0, 0.0, 0.0])
    same, side, back = (seen_from([front], 1, eye) for eye in (front, np.array([0.0, 1.0, 0.0]), -front))
    assert same > 0.85 and side < 0.3 and back < 0.1 and same > side > back
    assert seen_from([], 5, front) == 0.0
    assert seen_from([front] * 5, 5, front) > same  # the chance that any of them has seen it


def test_entropy_of_pixels_by_hand() -> None:
    seen, never, half, nothing = [1.0, 0.3, 0.09], [0.0, 0.0, 0.0], [0.5, 0.25, 0.125], [0.0, 0.0, 0.0]
    two_colours, thin = [1.0, 0.5, 0.34], [0.5, 0.15, 0.045]  # half .2 and half .8; half known and half background
    moments = np.array([[seen, never, half, nothing, two_colours, thin]])
    alpha = np.array([[1.0, 1.0, 1.0, 0.0, 1.0, 0.5]])
    channel, choice = 0.5 * np.log(1.0 / 0.01**2), np.log(2.0)  # a channel never seen; which of two parts a pixel shows
    mixed = 1.5 * np.log((0.09 + 0.01**2) / 0.01**2)
    expected = [0.0, 3.0 * channel, choice + 1.5 * channel, 0.0, mixed, choice]
    assert excess_entropy(moments, alpha)[0] == pytest.approx(expected, abs=1e-6)


def test_a_near_pixel_counts_by_the_square_of_its_distance_and_a_far_one_as_it_is() -> None:
    distance, alpha = np.array([0.25, 1.0, 2.0, 4.0, 0.0]), np.array([0.5, 1.0, 1.0, 0.8, 0.0])
    assert near_factor(distance, alpha, 2.0) == pytest.approx([0.0625, 0.25, 1.0, 1.0, 0.0])


def test_an_unseen_wall_is_more_uncertain_from_far_than_from_near(two_walls) -> None:
    two_walls.know(FREE)
    behind = np.array([-1.0, 0.0, 0.0])  # the east wall is at x = 2 m, and 0.29 of the diagonal is 3 m
    far, near = (look_along(np.array([x, 0.0, 0.0]), behind) for x in (5.0, 3.0))
    gains = evaluate_features(("gavis",), two_walls.context(far, near))[:, 0]
    slant = 1.17  # mean square of a pixel's distance from the camera, divided by that of its depth
    assert gains[1] / gains[0] == pytest.approx(slant / 9.0, rel=0.4)


def test_virtual_gaussians_fill_what_nobody_has_looked_into_and_nothing_else(two_walls) -> None:
    two_walls.know(UNKNOWN)
    volume = two_walls.volume
    few, many = virtual_gaussians(volume, 30), virtual_gaussians(volume, 2000)
    assert 0 < few.shape[1] <= 30 < many.shape[1] <= 2000
    for balls in (few, many):
        assert volume.unobserved[tuple(volume.voxel_of(balls[:3].T.astype(float)).T)].all()
    everything, real = with_virtual(two_walls.mapper.map, volume)
    assert real == two_walls.mapper.map.count < everything.count
    two_walls.know(FREE)
    assert virtual_gaussians(volume, 30).shape == (14, 0)


def test_what_was_seen_is_certain_a_void_is_not_and_free_space_is(two_walls, looks) -> None:
    small = {"bounds": np.array([[-0.2] * 3, [0.2] * 3])}  # so that nothing is near: the void begins at the camera
    east, west, north = evaluate_features(("gavis",), two_walls.context(*looks, **small))[:, 0]
    assert 0.0 < east < west < north  # three looks, one look, none
    two_walls.know(FREE)  # the void in the north was looked through
    freed = evaluate_features(("gavis",), two_walls.context(*looks, **small))[:, 0]
    assert freed[2] == 0.0 and freed[1] > freed[0] > 0.0


def test_the_wall_from_its_other_side_is_uncertain(two_walls) -> None:
    two_walls.know(FREE)
    inside = look_along(np.zeros(3), np.array([1.0, 0.0, 0.0]))
    outside = look_along(np.array([4.0, 0.0, 0.0]), np.array([-1.0, 0.0, 0.0]))
    seen, unseen = evaluate_features(("gavis",), two_walls.context(inside, outside))[:, 0]
    assert unseen > 1.5 * seen  # whose colours vary
