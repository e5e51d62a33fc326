from dataclasses import asdict

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from activestructure_gym.evaluation.metrics.geometry import (
    SurfaceSamples,
    geometry_scores,
    nearest_distances,
)


def wall(count: int, rng: np.random.Generator, size: float = 2.0) -> SurfaceSamples:
    """A square in the plane z = 0."""
    points = np.zeros((count, 3))
    points[:, :2] = rng.uniform(0.0, size, (count, 2))
    return SurfaceSamples(points, np.tile([0.0, 0.0, 1.0], (count, 1)), size**2)


def room(count: int, rng: np.random.Generator, size: tuple[float, float, float] = (5.0, 4.0, 3.0)) -> SurfaceSamples:
    """The inside of a box, sampled by area."""
    extent = np.array(size)
    areas = np.array([extent[1] * extent[2], extent[0] * extent[2], extent[0] * extent[1]])
    axis = rng.choice(3, count, p=areas / areas.sum())
    points = rng.uniform(0.0, 1.0, (count, 3)) * extent
    points[np.arange(count), axis] = rng.integers(0, 2, count) * extent[axis]
    return SurfaceSamples(points, np.eye(3)[axis], 2.0 * float(areas.sum()))


def test_nearest_distances_equal_brute_force(rng):
    queries, points = rng.normal(size=(50, 3)), rng.normal(size=(70, 3))
    np.testing.assert_allclose(nearest_distances(queries, points), cdist(queries, points).min(axis=1))


def test_points_three_centimetres_above_a_wall(rng):
    surface = wall(20_000, rng)
    points = np.column_stack([rng.uniform(0.3, 1.7, (5_000, 2)), np.full(5_000, 0.03)])
    scores = geometry_scores(points, surface)
    # The discs lie in the wall, so the distance to them is 3 cm wherever one covers the foot of the perpendicular.
    assert scores.accuracy_cm == pytest.approx(3.0, abs=0.01)
    # Samples are 1.41 cm apart: sqrt(3^2 + ...) is above 3 by the bias that the discs remove.
    assert 3.05 < scores.sample_accuracy_cm < 3.3
    assert scores.precision == 100.0


def test_distance_to_discs_has_little_of_the_bias_of_the_distance_to_samples(rng):
    # Points exactly on the wall, away from its edges. The mean distance to the nearest of random samples is half
    # their spacing sqrt(4 / 10000) = 2 cm; to discs of radius r = 0.8 spacings it is 1 cm * erfc(sqrt(2)) = 0.0455 cm.
    points = np.column_stack([rng.uniform(0.2, 1.8, (20_000, 2)), np.zeros(20_000)])
    surface = wall(10_000, rng)
    to_surface, to_sample = surface.discs.query(points)[0], surface.samples.query(points)[0]
    assert to_sample.mean() == pytest.approx(0.01, rel=0.05)
    assert to_surface.mean() == pytest.approx(0.01 * 0.0455, rel=0.15)


def test_half_a_wall_seen(rng):
    surface = wall(40_000, rng)
    seen = surface.points[surface.points[:, 0] < 1.0]
    scores = geometry_scores(seen, surface)
    # Seen: x < 1, and a strip of 5 cm beyond: (1 + 0.05) / 2.
    assert scores.completion_ratio == pytest.approx(52.5, abs=0.7)
    # The unseen half is on average 0.5 m from the seen one; over everything 25 cm.
    assert scores.completion_cm == pytest.approx(25.0, abs=0.5)
    assert scores.precision == 100.0
    assert scores.f_score == pytest.approx(2 * 100 * 52.5 / 152.5, abs=0.6)


def test_the_threshold_is_strict():
    surface = SurfaceSamples(np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]), 0.0)
    at_threshold = geometry_scores(np.array([[0.0, 0.0, 0.5]]), surface, threshold_m=0.5)
    assert (at_threshold.completion_ratio, at_threshold.precision, at_threshold.f_score) == (0.0, 0.0, 0.0)
    below = geometry_scores(np.array([[0.0, 0.0, 0.499]]), surface, threshold_m=0.5)
    assert (below.completion_ratio, below.precision, below.f_score) == (100.0, 100.0, 100.0)


def test_without_a_surface_no_number_is_defined():
    surface = SurfaceSamples(np.zeros((0, 3)), np.zeros((0, 3)), 0.0)
    for points in (np.zeros((0, 3)), np.ones((4, 3))):
        assert set(asdict(geometry_scores(points, surface)).values()) == {None}


def test_points_that_are_not_finite_do_not_count(rng):
    surface, points = wall(400, rng), rng.uniform(0.0, 2.0, (50, 3))
    odd = np.concatenate([points, [[np.nan, 0, 0], [0, np.inf, 0]]])
    assert geometry_scores(odd, surface) == geometry_scores(points, surface)
    broken = SurfaceSamples(
        np.concatenate([surface.points, [[np.nan] * 3]]), np.concatenate([surface.normals, [[0, 0, 1]]]), surface.area
    )
    scores = asdict(geometry_scores(points, broken))
    assert all(np.isfinite(value) for value in scores.values())
    nothing = geometry_scores(np.full((3, 3), np.nan), surface)
    assert nothing == geometry_scores(np.zeros((0, 3)), surface)


def test_nothing_reconstructed_scores_zero_and_has_no_distances(rng):
    scores = geometry_scores(np.zeros((0, 3)), wall(100, rng))
    assert scores.accuracy_cm is scores.completion_cm is scores.sample_accuracy_cm is None
    assert (scores.completion_ratio, scores.precision, scores.f_score) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("share", [0.05, 0.2, 0.5])
def test_floaters_lower_accuracy_and_precision_and_leave_completion(rng, share):
    # The table of docs/notebook/lab_notes.md: a complete room with 1 cm of noise, and floaters beside it.
    surface = room(60_000, rng)
    good = room(30_000, rng).points + rng.normal(scale=0.01, size=(30_000, 3))
    floaters = rng.uniform(0.0, 1.0, (int(share * len(good)), 3)) * [5.0, 4.0, 3.0]
    clean, dirty = geometry_scores(good, surface), geometry_scores(np.vstack([good, floaters]), surface)
    assert clean.accuracy_cm == pytest.approx(0.80, abs=0.12)  # mean |N(0, 1 cm)|, and the rest of the bias
    assert clean.precision > 99.9
    assert dirty.accuracy_cm > clean.accuracy_cm + 30 * share
    assert dirty.completion_cm == pytest.approx(clean.completion_cm, abs=0.05)
    # A floater is nearer than 5 cm to a wall with probability 1 - 4.9 * 3.9 * 2.9 / 60 = 7.6 %.
    assert dirty.precision == pytest.approx(100 * (1 + 0.076 * share) / (1 + share), abs=0.5)


@pytest.mark.parametrize("angle", [0.3, 2.0])
def test_scores_do_not_depend_on_the_frame(rng, angle):
    surface = room(3_000, rng)
    points = rng.uniform(0.0, 3.0, (500, 3))
    rotation = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1.0]])
    moved = SurfaceSamples(surface.points @ rotation.T + [3, -2, 1], surface.normals @ rotation.T, surface.area)
    before, after = geometry_scores(points, surface), geometry_scores(points @ rotation.T + [3, -2, 1], moved)
    assert after.accuracy_cm == pytest.approx(before.accuracy_cm)
    assert after.completion_cm == pytest.approx(before.completion_cm)
