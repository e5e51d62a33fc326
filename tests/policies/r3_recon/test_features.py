"""Renderability: of single places by hand, of many against plain Python, and which views it wants."""

from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.features import evaluate_features
from activestructure_gym.geometry import PinholeCamera, fibonacci_directions, look_along
from activestructure_gym.policies.r3_recon.features import _surface_views, lost_renderability, surrounding
from activestructure_gym.policies.r3_recon.surface_views import DIRECTIONS

CAMERA = PinholeCamera.from_size(32, 24, 60.0)
SIDES = fibonacci_directions(DIRECTIONS)


def lost(voxels: list[tuple], poses: list[np.ndarray], surface: float = np.inf) -> np.ndarray:
    """Sum of 1 - R of (centre, numbers of the seen directions, h, d_min)."""
    centres = np.array([voxel[0] for voxel in voxels], float).reshape(-1, 3)
    bits = np.array([sum(1 << side for side in voxel[1]) for voxel in voxels], np.uint64)
    rest = np.array([voxel[2:] for voxel in voxels], float).reshape(-1, 2)
    shown = np.full((len(poses), CAMERA.height, CAMERA.width), surface, np.float32)
    known = (centres, bits, np.ascontiguousarray(rest[:, 0]), np.ascontiguousarray(rest[:, 1]))
    return lost_renderability(known, np.array(poses), CAMERA.lens, shown, SIDES, surrounding())[:, 0]


def view(side: int, distance: float, turned: float = 0.0) -> np.ndarray:
    """A camera that looks at the origin from a direction of the 64, or ``turned`` (radians) away from it."""
    across = np.linalg.svd(SIDES[side][None])[2][1]
    back = np.cos(turned) * SIDES[side] + np.sin(turned) * across
    return look_along(distance * back, -back)


def test_one_place_by_hand() -> None:
    others = [side for side in range(64) if SIDES[side] @ SIDES[7] < -0.6]  # all around, and never the nearest

    def rendered(certainty: float, nearest: float, distance: float, turned: float = 0.0, sides: list = others) -> float:
        return 1.0 - lost([([0, 0, 0], [7, *sides], certainty, nearest)], [view(7, distance, turned)])[0]

    assert rendered(1.0, 2.0, 2.0) == pytest.approx(1.0)  # the same side and distance, one colour
    assert rendered(1.0, 2.0, 3.0) == pytest.approx(1.0)  # from farther away
    assert rendered(1.0, 2.0, 2.0, np.radians(60)) == pytest.approx(0.5)
    assert rendered(1.0, 2.0, 2.0, np.radians(100), []) == 0.0  # from behind
    # Seen from one side alone: a and h are squared.
    assert rendered(1.0, 2.0, 2.0, np.arccos(0.7), []) == pytest.approx(0.49)
    assert rendered(0.5, 2.0, 2.0, np.arccos(0.7), []) == pytest.approx(0.25**0.51 * 0.49)
    assert rendered(0.5, 2.0, 1.0, np.arccos(0.7), []) == pytest.approx(0.25**0.51 * 0.49 * 0.5 ** (1.0 - 0.49 * 0.25))
    # Colours that differ: h^(1 - a) a, and straight on nothing of it.
    assert rendered(0.25, 2.0, 2.0) == pytest.approx(1.0)
    assert rendered(0.25, 2.0, 2.0, np.radians(60)) == pytest.approx(0.25**0.5 * 0.5)
    # Half as far as any look: s = 1/2, (1 - s)^(1 - a h).
    assert rendered(1.0, 2.0, 1.0) == pytest.approx(1.0)
    assert rendered(0.0, 2.0, 1.0) == pytest.approx(0.5)  # 0^0 = 1
    assert rendered(0.5, 2.0, 1.0, np.radians(60)) == pytest.approx(0.5**0.5 * 0.5 * 0.5 ** (1.0 - 0.25))
    assert rendered(0.5, 0.0, 1.0, np.radians(60)) == pytest.approx(0.5**0.5 * 0.5)  # seen from near enough
    # Never seen from anywhere, and not in sight.
    assert lost([([0, 0, 0], [], 1.0, 2.0)], [view(7, 2.0)])[0] == 1.0
    assert lost([([0, 0, 0], [7], 1.0, 2.0)], [view(7, 2.0) @ np.diag([1.0, -1, -1, 1])])[0] == 0.0
    assert lost([([0, 0, 0], [], 1.0, 2.0)], [view(7, 2.0)], surface=1.94)[0] == 0.0  # hidden, by a wall
    assert lost([([0, 0, 0], [], 1.0, 2.0)], [view(7, 2.0)], surface=1.96)[0] == 1.0  # of the surface itself
    assert lost([([0, 0, 0], [], 1.0, 9.0)], [view(7, 9.0)])[0] == 1.0  # as far as the image shows
    assert lost([], [view(7, 2.0)])[0] == 0.0


def test_on_slanted_surface_the_deepest_neighbour_of_a_pixel_counts() -> None:
    centre = CAMERA.height // 2, CAMERA.width // 2
    # The last is the edge of an object, where the background reveals nothing behind it.
    cases = (0, 1, 1.9, 1.0), (1, 0, 1.9, 1.0), (0, 2, 1.9, 0.0), (2, 0, 1.9, 0.0), (0, 1, 1.8, 0.0)
    for down, right, own, seen in cases:
        shown = np.full((1, CAMERA.height, CAMERA.width), own, np.float32)
        shown[0, centre[0] + down, centre[1] + right] = 2.0
        shown[0, 0, 0] = shown[0, centre[0] - 1, centre[1]] = np.inf  # an uncovered pixel next to it shows nothing
        known = (np.zeros((1, 3)), np.zeros(1, np.uint64), np.ones(1), np.full(1, 2.0))
        found = lost_renderability(known, view(7, 2.0)[None], CAMERA.lens, shown, SIDES, surrounding())
        assert found.tolist() == [[seen, seen]]


def test_many_places_against_plain_python(rng: np.random.Generator) -> None:
    voxels = [
        (rng.normal(size=3), list(rng.choice(64, rng.integers(0, 9), replace=False)), rng.random(), 3 * rng.random())
        for _ in range(60)
    ]
    poses = [view(int(side), 2.0 + rng.random()) for side in rng.choice(64, 5, replace=False)]
    expected = []
    for pose in poses:
        total = 0.0
        for centre, sides, h, nearest in voxels:
            back = pose[:3, 3] - centre
            local = pose[:3, :3].T @ -back
            pixel = CAMERA.project(local)
            if local[2] <= 0 or not ((pixel >= 0) & (pixel < [CAMERA.width, CAMERA.height])).all():
                continue
            distance = np.linalg.norm(back)
            a = max([0.0, *(SIDES[sides] @ back / distance)])
            if sides:
                q = SIDES[sides[int((SIDES[sides] @ back).argmax())]]
                axis = np.eye(3)[np.abs(q).argmin()]
                u = axis - (axis @ q) * q
                at = np.array([SIDES[side] for side in sides if SIDES[side] @ q < 1 - 1e-9]).reshape(-1, 3)
                plane = at @ np.stack([u, np.cross(q, u)], axis=1)
                if not ((plane > 0).any(axis=0) & (plane < 0).any(axis=0)).all():
                    a, h = a * a, h * h
            s = max(0.0, 1.0 - distance / nearest)
            total += 1.0 - h ** (1 - a) * a * (1 - s) ** (1 - a * h)
        expected.append(total)
    assert lost(voxels, poses) == pytest.approx(expected) and min(expected) > 0


def test_a_void_first_then_the_side_that_nobody_saw(two_walls, looks, frame_of) -> None:
    context = two_walls.context(*looks)
    gains, means, unexplored = evaluate_features(("r3_recon", "unexplored"), context).T
    assert (
        (means[:2] > 0).all() and (means <= 1).all() and means[2] == 0
    )  # no voxel of surface is in sight in the north
    assert gains.argmax() == 2  # north: nobody looked there, and an unexplored voxel is worth 1000 of surface
    assert gains[2] == pytest.approx(unexplored[2], rel=1e-5)
    coarse = (np.array(two_walls.volume.shape) - 2).prod() * (0.1 / 0.2) ** 3
    assert 0 < gains[0] - unexplored[0] < 2000 / (1000 * coarse)  # fewer than 2000 voxels of wall are in sight
    from activestructure_gym.volume import FREE

    two_walls.know(FREE)
    beside = look_along(np.array([0.9, -1.2, 0.0]), np.array([0.5, 0.8, 0.0]))  # the east wall under a steep angle
    (straight, steep), means = evaluate_features(("r3_recon",), two_walls.context(looks[0], beside)).T
    visible = two_walls.context(looks[0], beside).episode(_surface_views).update(two_walls.mapper.keyframes)
    assert len(visible.centres) > 100 and 0.0 < straight
    assert steep > straight and means[1] > means[0]
