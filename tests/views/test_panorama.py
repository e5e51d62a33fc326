"""Panoramas: their geometry, DBSCAN against its definition, and the volume around an opening by hand."""

from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.views import panorama
from activestructure_gym.views.panorama import DEG_PER_PIXEL, camera, clusters, hull_volume, openings, poses


def brute_force(mask: np.ndarray, radius: float, least: int) -> tuple[list[frozenset], set]:
    """DBSCAN by its definition: the sets of cores that hang together, and the border pixels."""
    pixels = np.argwhere(mask)
    near = np.linalg.norm(pixels[:, None] - pixels, axis=2) <= radius
    core = near.sum(axis=1) >= least
    groups, left = [], set(np.flatnonzero(core))
    while left:
        group, fresh = set(), {min(left)}
        while fresh:
            group |= fresh
            fresh = {int(j) for i in fresh for j in np.flatnonzero(near[i] & core)} - group
        groups.append(frozenset(tuple(pixels[i]) for i in group))
        left -= group
    border = {tuple(p) for p in pixels[~core & (near & core).any(axis=1)]}
    return groups, border


@pytest.mark.parametrize(("share", "radius", "least"), [(0.25, 2.5, 6), (0.4, 2.5, 10), (0.1, 3.0, 5)])
def test_clusters_are_those_of_dbscan(rng: np.random.Generator, share: float, radius: float, least: int) -> None:
    mask = rng.random((24, 30)) < share
    labels = clusters(mask, radius, least)
    groups, border = brute_force(mask, radius, least)
    assert groups
    for group in groups:
        assert len({labels[p] for p in group}) == 1
    assert len({labels[min(group)] for group in groups}) == len(groups)
    assert {tuple(p) for p in np.argwhere(labels > 0)} == set().union(*groups) | border


def test_no_core_no_cluster() -> None:
    mask = np.zeros((9, 9), bool)
    mask[4, ::2] = True
    assert not clusters(mask, 2.5, 6).any()


def test_the_sides_make_a_full_turn_in_the_order_of_their_images() -> None:
    lens, views = camera(), poses(np.array([[1.0, 2.0, 1.5]]))
    np.testing.assert_allclose(views[:, :3, 3], [[1.0, 2.0, 1.5]] * 3)
    np.testing.assert_allclose(views[:, 2, 1], -1.0)  # level: the image's down is the world's
    # What leaves one image on its right enters the next on its left; the corner rays meet.
    right, left = (np.array([x, 0.0, 1.0]) for x in ((lens.width - lens.cx) / lens.fx, -lens.cx / lens.fx))
    for one, two in ((0, 1), (1, 2), (2, 0)):
        np.testing.assert_allclose(views[one, :3, :3] @ right, views[two, :3, :3] @ left, atol=1e-9)
    assert 2 * np.degrees(np.arctan(lens.cy / lens.fy)) == pytest.approx(150.0)
    images = np.arange(6)[:, None, None] * np.ones((6, 2, 4))
    joined = panorama.side_by_side(images)
    assert joined.shape == (2, 2, 12)
    assert joined[1, 0].tolist() == [3.0] * 4 + [4.0] * 4 + [5.0] * 4


def test_an_opening_in_a_flat_surround_has_no_volume_and_before_a_step_it_has() -> None:
    alpha, depth = np.ones((75, 180), np.float32), np.full((75, 180), 2.0, np.float32)
    alpha[30:40, 50:70] = depth[30:40, 50:70] = 0.0
    flat = openings(alpha, depth)
    assert len(flat) == 1
    assert flat[0].missing == pytest.approx(200 * DEG_PER_PIXEL**2)
    assert flat[0].volume == 0.0
    depth[:, 60:] += 1.0
    depth[30:40, 50:70] = 0.0
    stepped = openings(alpha, depth)
    # The outline lies 3 pixels beyond the opening, so its corners are 25 x 15 steps apart, half of them at each depth.
    # The straight parts between the corners do not count: with all of them, the hull would be half the rectangle times
    # the step of 1 m. Rounded corners have some steps of their own, so it is more than a plane.
    half = 0.5 * np.radians(50.0) * np.radians(30.0)
    assert 0.2 * half < stepped[0].volume < 0.25 * half


def test_small_or_veiled_gaps_are_no_opening() -> None:
    alpha, depth = np.ones((75, 180), np.float32), np.full((75, 180), 2.0, np.float32)
    alpha[10, 10:14] = 0.0  # 4 pixels of 4 square degrees
    alpha[40:60, 40:60] = 0.25  # 0.75 is missing
    assert openings(alpha, depth) == []
    alpha[40:60, 40:60] = 0.15
    assert openings(alpha, depth)[0].missing == pytest.approx(0.85 * 400 * DEG_PER_PIXEL**2, rel=1e-5)


def test_two_openings_apart_are_two_and_near_each_other_one() -> None:
    alpha, depth = np.ones((75, 180), np.float32), np.full((75, 180), 2.0, np.float32)
    alpha[10:20, 10:20] = alpha[10:20, 30:40] = 0.0
    assert len(openings(alpha, depth)) == 2
    alpha[10:20, 21:40] = 0.0  # one column of pixels between them is within the radius
    assert len(openings(alpha, depth)) == 1


def test_of_two_outlines_the_larger_one_spans_the_hull_by_its_corners() -> None:
    mask, depth = np.zeros((75, 180), bool), np.full((75, 180), 2.0, np.float32)
    mask[30:40, 50:70] = True
    depth[:, 60] = 9.0  # met by straight parts of the outline alone, whose inner points do not count
    alone = hull_volume(mask, depth)
    mask[32:36, 120:124] = True
    assert hull_volume(mask, depth) == alone == pytest.approx(0.0, abs=1e-9)
    depth[:, :60] = 3.0
    mask[32:36, 120:124] = False
    assert hull_volume(mask, depth) > 0.01


def test_a_hull_needs_four_points_with_a_surface() -> None:
    mask, depth = np.zeros((75, 180), bool), np.zeros((75, 180), np.float32)
    mask[30:40, 50:70] = True
    assert hull_volume(mask, depth) == 0.0


@pytest.mark.parametrize(("left", "right", "volume", "information"), [
    ((3.0, 1.0), (3.0, 0.3), 0.0, 0),  # a flat wall, half of it without a median depth
    ((2.0, 1.0), (4.0, 0.5001), 0.295, 133),  # a step of 2 m
])  # fmt: skip
def test_a_hole_of_12_degrees_before_surfaces_of_two_opacities(
    left: tuple[float, float], right: tuple[float, float], volume: float, information: float
) -> None:
    """Surfaces are (depth, opacity); the depth is the median one, 0 where alpha is at most one half."""
    rows, columns = np.indices((75, 180))
    hole = np.hypot(rows - 37, columns - 90) * DEG_PER_PIXEL <= 12.0
    depth, alpha = (np.where(columns < 90, *two) * ~hole for two in zip(left, right))
    found = openings(alpha, np.where(alpha > 0.5, depth, 0.0))
    assert sum(opening.volume for opening in found) == pytest.approx(volume, abs=5e-4)
    assert sum(opening.volume * opening.missing for opening in found) == pytest.approx(information, abs=0.5)
