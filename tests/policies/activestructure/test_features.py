"""Gains that ask the planes and the volume: hand-made holes, walls and windows."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from activestructure_gym.features import FeatureContext, evaluate_features
from activestructure_gym.features.hole_area import REACH, largest_area, solid_angles, taken_before
from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.planes import Deficiencies
from activestructure_gym.policies.activestructure.features import pixel_share, pixels_per_area, refining_distance
from activestructure_gym.volume import FREE, OCCUPIED, UNKNOWN, VolumeConfig, VoxelVolume

CAMERA = PinholeCamera.from_size(40, 24)
SENSOR = PinholeCamera.from_size(160, 96)
BOUNDS = np.array([[0.0, 0, 0], [4.0, 4, 4]])
HERE = np.array([1.0, 2.0, 2.0])
AHEAD = look_along(HERE, np.array([1.0, 0.0, 0.0]))
BACK = look_along(HERE, np.array([-1.0, 0.0, 0.0]))
ELSEWHERE = look_along(np.array([3.9, 3.9, 3.9]), np.array([0.0, 0.0, 1.0]))  # where the keyframe was taken


def holes(
    centres: list, areas: float = 0.04, sizes: float = np.inf, normal: tuple = (-1.0, 0, 0), explained: bool = False
) -> Deficiencies:
    count = len(centres)
    return Deficiencies(
        np.array(centres, float).reshape(count, 3),
        np.tile(np.array(normal, float), (count, 1)),
        np.full(count, areas),
        np.zeros(count, np.int64),
        np.full(count, sizes),
        np.full(count, explained),
    )


def context(
    poses: list, found: Deficiencies | None = None, alpha: np.ndarray | float = 0.0, state: np.ndarray | None = None,
    coarse_ratio: float | None = 3.0, keyframe_reduction: int = 1, **changes: Any,
) -> FeatureContext:  # fmt: skip
    volume = VoxelVolume(BOUNDS, VolumeConfig())
    volume.state[:] = FREE
    if state is not None:
        volume.state[:] = state
    images = np.broadcast_to(np.asarray(alpha, np.float32), (len(poses), CAMERA.height, CAMERA.width)).copy()
    mapper = SimpleNamespace(
        render_depth_alpha=lambda camera, poses: (np.zeros_like(images), images),
        config=SimpleNamespace(
            coarse_ratio=coarse_ratio,
            seed_spacing=0.05,
            seed_footprint=0.6,
            seed_pixels=2.0,
            keyframe_reduction=keyframe_reduction,
        ),
        keyframes=[SimpleNamespace(camera=SENSOR, world_from_camera=ELSEWHERE)],
    )
    options: dict[str, Any] = {
        "mapper": mapper,
        "volume": volume,
        "planes": SimpleNamespace(deficiencies=holes([]) if found is None else found, nodes=[]),
        "camera": CAMERA,
        "bounds": BOUNDS,
        "coverage_alpha": 0.5,
        "max_range": 10.0,
        "world_from_camera": np.stack(poses),
    }
    return FeatureContext(**{**options, **changes})


def column(name: str, ctx: FeatureContext) -> np.ndarray:  # [K]
    return evaluate_features((name,), ctx)[:, 0]


def slab(low: float, high: float) -> np.ndarray:  # [X, Y, Z] bool, between two values of x
    volume = VoxelVolume(BOUNDS, VolumeConfig())
    x = volume.center_of(np.indices(volume.shape).transpose(1, 2, 3, 0))[..., 0]
    return (x > low) & (x < high)


WHOLE = largest_area(CAMERA)  # m^2


def test_deficiency_by_hand_and_only_where_one_looks() -> None:
    near, far = [2.0, 2.0, 2.0], [3.9, 2.0, 2.0]
    np.testing.assert_allclose(column("deficiency", context([AHEAD, BACK], holes([near]))), [0.04 / WHOLE, 0.0])
    # An area counts the same from wherever it is in reach.
    assert column("deficiency", context([AHEAD], holes([far])))[0] == pytest.approx(0.04 / WHOLE)
    np.testing.assert_array_equal(column("deficiency", context([AHEAD, BACK])), 0.0)


def test_deficiency_counts_the_side_it_was_seen_from_up_to_the_reach() -> None:
    assert column("deficiency", context([AHEAD], holes([[3.0, 2.0, 2.0]], normal=(1.0, 0, 0))))[0] == 0.0
    beyond = holes([HERE + [REACH + 0.01, 0, 0]])
    within = holes([HERE + [REACH - 0.01, 0, 0]])
    assert [column("deficiency", context([AHEAD], h))[0] > 0 for h in (beyond, within)] == [False, True]


def test_a_hole_that_an_image_explained_does_not_count() -> None:
    window = holes([[3.0, 2.0, 2.0]], explained=True)
    assert column("deficiency", context([AHEAD], window))[0] == 0.0


def test_deficiency_adds_up(rng: np.random.Generator) -> None:
    one, other = [3.0, 2.2, 2.0], [3.0, 1.8, 2.1]
    values = [column("deficiency", context([AHEAD], holes(h)))[0] for h in ([one], [other], [one, other])]
    assert values[2] == pytest.approx(values[0] + values[1], rel=1e-6)
    many = rng.uniform([2, 0, 0], 4, (500, 3))
    poses = [look_along(rng.uniform(0.5, 3.5, 3), rng.normal(size=3)) for _ in range(30)]
    gain = column("deficiency", context(poses, holes(list(many), areas=0.25)))
    assert ((gain >= 0) & (gain <= 500 * 0.25 / WHOLE)).all()
    assert len(np.unique(gain)) > 10


def test_deficiency_is_zero_behind_what_is_occupied() -> None:
    found = holes([[3.0, 2.0, 2.0]])
    blocked = np.where(slab(1.9, 2.1), OCCUPIED, FREE)
    unknown = np.where(slab(1.9, 2.1), UNKNOWN, FREE)
    own_wall = np.where(slab(3.0, 3.1), OCCUPIED, FREE)
    gains = [column("deficiency", context([AHEAD], found, state=s))[0] for s in (blocked, unknown, own_wall)]
    assert gains[0] == 0.0
    assert gains[1] == gains[2] > 0.0


def test_a_coarse_patch_counts_from_where_its_gaussians_would_be_replaced() -> None:
    # Gaussians of s metres fill s f / z pixels; the limit is 3 x 0.6 x 2 = 3.6 pixels.
    focal = 0.5 * (SENSOR.fx + SENSOR.fy)
    for size, counts in ((2.01 * 3.6 / focal, True), (1.99 * 3.6 / focal, False)):
        found = holes([[3.0, 2.0, 2.0]], sizes=size)
        assert (column("deficiency", context([AHEAD], found))[0] > 0) == counts
        nearer = look_along(HERE + [0.5, 0, 0], np.array([1.0, 0.0, 0.0]))
        assert column("deficiency", context([nearer], found))[0] > 0
        assert column("deficiency", context([nearer], found, coarse_ratio=None))[0] == 0.0  # nothing is ever replaced
    distances = refining_distance(context([AHEAD]), np.array([0.1, 0.2, np.inf]))
    np.testing.assert_allclose(distances, [0.1 * focal / 3.6, 0.2 * focal / 3.6, np.inf])
    # Keyframes are kept with fewer pixels than they were seeded with.
    fewer = refining_distance(context([AHEAD], keyframe_reduction=4), np.array([0.1, 0.2, np.inf]))
    np.testing.assert_allclose(fewer, 4 * distances)
    assert column("deficiency", context([AHEAD], holes([[3.0, 2.0, 2.0]]), coarse_ratio=None))[0] > 0


def test_a_deficiency_that_was_looked_at_in_vain_loses_its_pull() -> None:
    centre = np.array([3.0, 2.0, 2.0])
    found, full = holes([centre]), 0.04 / WHOLE
    nearer = look_along(HERE + [1.0, 0, 0], np.array([1.0, 0.0, 0.0]))  # 1 m away instead of 2: four times the pixels
    views = context([AHEAD, nearer, BACK], found)
    for times in range(4):
        again = 1 / (1 + times)
        np.testing.assert_allclose(
            column("deficiency", context([AHEAD, nearer, BACK], found, mapper=views.mapper)),
            [full * again, full * 4 / (4 + times), 0.0],
            rtol=1e-6,
        )
        # One that looked elsewhere spends nothing.
        views.mapper.keyframes += [SimpleNamespace(camera=SENSOR, world_from_camera=pose) for pose in (AHEAD, BACK)]


def test_a_look_from_too_far_or_from_behind_something_spends_nothing() -> None:
    focal = 0.5 * (SENSOR.fx + SENSOR.fy)
    nearer = look_along(HERE + [0.5, 0, 0], np.array([1.0, 0.0, 0.0]))
    coarse = holes([[3.0, 2.0, 2.0]], sizes=1.6 * 3.6 / focal)  # is replaced from 1.6 m on, and seen from 2 m
    seen = context([nearer], coarse)
    seen.mapper.keyframes.append(SimpleNamespace(camera=SENSOR, world_from_camera=AHEAD))
    assert column("deficiency", seen)[0] == pytest.approx(0.04 / WHOLE)
    hidden = context([nearer], holes([[3.0, 2.0, 2.0]]), state=np.where(slab(1.1, 1.3), OCCUPIED, FREE))
    hidden.mapper.keyframes.append(SimpleNamespace(camera=SENSOR, world_from_camera=AHEAD))
    assert column("deficiency", hidden)[0] == pytest.approx(0.04 / WHOLE)


def test_pull_by_hand_and_falls_with_what_was_spent(rng: np.random.Generator) -> None:
    eye = np.stack([AHEAD, BACK])
    np.testing.assert_allclose(
        pixels_per_area(np.array([[0.5, 0.0], [0.0, 0.0]]), eye, np.array([[3.0, 2.0, 2.0], [1.0, 2.0, 2.0]])),
        [[0.5 / 4, 0.0], [0.0, 0.0]],
    )
    np.testing.assert_allclose(
        pixel_share(np.array([[1.0, 3.0, 0.0, 0.0]]), np.array([1.0, 0, 2.0, 0.0])), [[0.5, 1, 0, 0]]
    )
    looks, spent, more = rng.uniform(0.1, 5, (8, 20)), rng.uniform(0, 5, 20), rng.uniform(0.1, 5, 20)
    assert (pixel_share(looks, spent + more) < pixel_share(looks, spent)).all()
    assert (pixel_share(looks + more, spent) >= pixel_share(looks, spent)).all()


def test_space_known_to_be_free_to_the_end_hides_nothing() -> None:
    free = context([AHEAD, BACK])
    np.testing.assert_array_equal(column("pixel", free), 1.0)
    np.testing.assert_array_equal(column("hole_area", free), 0.0)
    # Unknown ahead: all rays that go forward meet it, none of those that go back.
    ahead = context([AHEAD, BACK], state=np.where(slab(2.0, 4.0), UNKNOWN, FREE), max_range=2.0)
    gain = column("hole_area", ahead)
    assert gain[0] > 0.2
    assert gain[1] == 0.0


def test_a_view_that_was_a_keyframe_hides_nothing() -> None:
    ahead, degree = np.array([1.0, 0.0, 0.0]), np.radians(1.0)
    turned = [look_along(HERE, np.array([np.cos(a), np.sin(a), 0.0])) for a in (4.9 * degree, 5.1 * degree)]
    moved = [look_along(HERE + [0.0, step, 0.0], ahead) for step in (0.049, 0.051)]
    poses = np.stack([AHEAD, *turned, *moved, BACK])
    known = [True, True, False, True, False, False]
    assert taken_before(poses, np.stack([ELSEWHERE, AHEAD])).tolist() == known
    assert not taken_before(poses, np.empty((0, 4, 4))).any()
    views = context(list(poses), state=UNKNOWN)
    assert (column("hole_area", views) > 0).all()
    views = context(list(poses), state=UNKNOWN)
    views.mapper.keyframes.append(SimpleNamespace(camera=SENSOR, world_from_camera=AHEAD))
    assert (column("hole_area", views) == 0).tolist() == known


def test_a_surface_without_gaussians_is_a_hole_and_ends_the_search() -> None:
    state = np.where(slab(3.0, 4.0), UNKNOWN, FREE)
    beyond = column("hole_area", context([AHEAD], state=state))[0]
    # A wall at 1.4 m fills the image: the area in view is what the image cuts out of it, seen along the rays.
    walled = column("hole_area", context([AHEAD], state=np.where(slab(2.4, 2.6), OCCUPIED, state)))[0]
    assert 0 < walled < beyond
    distance = 1.4 * np.linalg.norm(CAMERA.rays(), axis=-1)
    expected = (solid_angles(CAMERA) * distance**2).sum() / WHOLE
    assert walled == pytest.approx(expected, rel=0.05)  # marched in steps of half a voxel
    assert column("hole_area", context([AHEAD], state=state, max_range=1.5))[0] == 0.0


def test_covered_pixels_hide_nothing_and_half_covered_ones_half() -> None:
    whole = column("hole_area", context([AHEAD], state=UNKNOWN))[0]
    alpha = np.ones((1, 24, 40), np.float32)
    assert column("hole_area", context([AHEAD], alpha=alpha, state=UNKNOWN))[0] == 0.0
    assert column("hole_area", context([AHEAD], alpha=0.5 * alpha, state=UNKNOWN))[0] == pytest.approx(whole / 2)


def test_what_lies_beyond_the_reach_counts_as_at_the_reach() -> None:
    bounds = np.array([[0.0, 0, 0], [14.0, 4, 4]])
    volume = VoxelVolume(bounds, VolumeConfig())
    volume.state[:] = FREE
    volume.state[volume.shape[0] - 20 :] = UNKNOWN
    ahead = look_along(np.array([1.0, 2.0, 2.0]), np.array([1.0, 0.0, 0.0]))
    gain = column("hole_area", context([ahead], volume=volume, bounds=bounds, max_range=20.0))[0]
    # Unknown begins 11 m ahead or half a voxel farther; the walls of the box are 2 m away on every side.
    rays = CAMERA.rays()[::2, ::2]
    least, most = (
        4 * solid_angles(CAMERA)[::2, ::2][(np.abs(rays) <= [slope, slope, 1]).all(axis=-1)].sum() * REACH**2 / WHOLE
        for slope in (2 / 11.3, 2 / 10.9)
    )
    assert 0 < least <= gain <= most


def test_hole_area_is_a_share(rng: np.random.Generator) -> None:
    poses = [look_along(rng.uniform(0.5, 3.5, 3), rng.normal(size=3)) for _ in range(20)]
    alpha = rng.uniform(0, 1, (20, 24, 40))
    shape = VoxelVolume(BOUNDS, VolumeConfig()).shape
    blocks = rng.choice([FREE, OCCUPIED, UNKNOWN], p=[0.9, 0.05, 0.05], size=tuple(-(-n // 4) for n in shape))
    state = np.kron(blocks, np.ones((4, 4, 4), np.uint8))[: shape[0], : shape[1], : shape[2]]
    gains = column("hole_area", context(poses, alpha=alpha, state=state))
    assert ((gains >= 0) & (gains <= 1)).all()
    assert len(np.unique(gains)) > 10
    opaque = column("hole_area", context(poses, alpha=0.5 + 0.5 * alpha, state=state))
    assert (opaque <= 0.5 * gains + 1e-6).all()


def test_structure_is_the_deficit_of_the_planes_in_view() -> None:
    corners = np.insert(np.stack(np.meshgrid(*2 * [np.linspace(-0.1, 0.1, 4)]), axis=-1).reshape(-1, 2), 0, 0.0, axis=1)
    facing = [
        SimpleNamespace(spread=lambda count, x=x: np.array([x, 2.0, 2.0]) + corners[:count], normal=np.array(n, float))
        for x, n in ((3.0, (-1, 0, 0)), (3.2, (-1, 0, 0)), (0.2, (1, 0, 0)), (3.0, (1, 0, 0)))
    ]
    state = SimpleNamespace(deficit=np.array([0.1, 0.2, 0.4, 0.8]))
    graph = SimpleNamespace(nodes=facing, state=state, deficiencies=holes([]))
    ctx = context([AHEAD, BACK], planes=graph)
    np.testing.assert_allclose(column("structure", ctx), [0.3, 0.4], rtol=1e-6)
    np.testing.assert_allclose(column("structure", ctx), ctx.visible @ graph.state.deficit, rtol=1e-6)
