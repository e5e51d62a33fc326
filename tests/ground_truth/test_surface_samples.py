from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from activestructure_gym.ground_truth.surface_samples import lattice_samples, uniform_samples


def test_every_surface_point_has_a_lattice_sample_nearby(rng):
    """Random triangles of all shapes, needles among them: no random surface point is farther than spacing / sqrt 2."""
    vertices = rng.normal(size=(300, 3)) * [3.0, 1.0, 0.05]
    faces = rng.permutation(300).reshape(-1, 3)
    spacing = 0.1
    samples = lattice_samples(vertices, faces, spacing)
    points, _, _ = uniform_samples(vertices, faces, 20_000, rng)
    distance = cKDTree(samples).query(points)[0]
    assert distance.max() <= spacing / np.sqrt(2) + 1e-9
    on_surface = cKDTree(uniform_samples(vertices, faces, 200_000, rng)[0]).query(samples)[0]
    assert np.percentile(on_surface, 99) < 0.1  # and the samples lie on the surface


def test_a_needle_costs_a_row_and_not_a_square():
    needle = np.array([[0, 0, 0], [10, 0, 0], [5, 0.001, 0]])
    assert len(lattice_samples(needle, np.array([[0, 1, 2]]), 0.1)) == 100


def test_small_faces_get_one_sample_each(make_box):
    vertices, faces = make_box((0, 0, 0), (0.01, 0.01, 0.01))
    assert len(lattice_samples(vertices, faces, 0.1)) == 12


def test_uniform_samples_are_uniform_by_area(make_box, rng):
    vertices, faces = make_box((0, 0, 0), (4, 3, 2))
    points, normals, area = uniform_samples(vertices, faces, 30_000, rng)
    assert area == pytest.approx(2 * (12 + 8 + 6))
    side = np.abs(normals).argmax(axis=1)
    share = np.bincount(side, minlength=3) / len(points)
    np.testing.assert_allclose(share, np.array([6, 8, 12]) / 26, atol=1e-3)  # stratified over the area
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0)
    floor = points[(side == 2) & (points[:, 2] < 1)]
    # Means and variances of a uniform rectangle of 4 x 3: 2, 1.5 and 16/12, 9/12; 7000 points, 4 sigma.
    np.testing.assert_allclose(floor[:, :2].mean(axis=0), [2, 1.5], atol=0.06)
    np.testing.assert_allclose(floor[:, :2].var(axis=0), [16 / 12, 9 / 12], rtol=0.05)
    along = np.take_along_axis(points, side[:, None], axis=1)[:, 0]
    np.testing.assert_allclose(np.minimum(np.abs(along), np.abs(along - np.array([4, 3, 2])[side])), 0, atol=1e-12)
