"""Gains that ask the planes and the volume: hand-made holes, walls and windows."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.planes import Deficiencies
from activestructure_gym.views import GainContext, evaluate_gains
from activestructure_gym.views.gains.deficiency import refining_distance
from activestructure_gym.volume import FREE, OCCUPIED, UNKNOWN, VolumeConfig, VoxelVolume

CAMERA = PinholeCamera.from_size(40, 24)
SENSOR = PinholeCamera.from_size(160, 96)
BOUNDS = np.array([[0.0, 0, 0], [4.0, 4, 4]])
HERE = np.array([1.0, 2.0, 2.0])
AHEAD = look_along(HERE, np.array([1.0, 0.0, 0.0]))
BACK = look_along(HERE, np.array([-1.0, 0.0, 0.0]))


def holes(centres: list, areas: float = 0.04, sizes: float = np.inf, normal: tuple = (-1.0, 0, 0)) -> Deficiencies:
    count = len(centres)
    return Deficiencies(
        np.array(centres, float).reshape(count, 3),
        np.tile(np.array(normal, float), (count, 1)),
        np.full(count, areas),
        np.zeros(count, np.int64),
        np.full(count, sizes),
    )


def context(
    poses: list, found: Deficiencies | None = None, alpha: np.ndarray | float = 0.0, state: np.ndarray | None = None,
    coarse_ratio: float | None = 3.0, **changes: Any,
) -> GainContext:  # fmt: skip
    volume = VoxelVolume(BOUNDS, VolumeConfig())
    volume.state[:] = FREE
    if state is not None:
        volume.state[:] = state
    images = np.broadcast_to(np.asarray(alpha, np.float32), (len(poses), CAMERA.height, CAMERA.width)).copy()
    mapper = SimpleNamespace(
        render_depth_alpha=lambda camera, poses: (np.zeros_like(images), images),
        config=SimpleNamespace(coarse_ratio=coarse_ratio, seed_footprint=0.6, seed_stride=2),
        keyframes=[SimpleNamespace(camera=SENSOR)],
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
    return GainContext(**{**options, **changes})


def column(name: str, ctx: GainContext) -> np.ndarray:  # [K]
    return evaluate_gains((name,), ctx)[:, 0]


def slab(low: float, high: float) -> np.ndarray:  # [X, Y, Z] bool, between two values of x
    volume = VoxelVolume(BOUNDS, VolumeConfig())
    x = volume.center_of(np.indices(volume.shape).transpose(1, 2, 3, 0))[..., 0]
    return (x > low) & (x < high)


def test_deficiency_by_hand_and_only_where_one_looks() -> None:
    ctx = context([AHEAD, BACK], holes([[3.0, 2.0, 2.0]]))
    # 0.04 m^2 seen frontally from 2 m: fx fy 0.04 / 4 pixels.
    expected = CAMERA.fx * CAMERA.fy * 0.01 / (40 * 24)
    np.testing.assert_allclose(column("deficiency", ctx), [expected, 0.0], rtol=1e-6)
    np.testing.assert_array_equal(column("deficiency", context([AHEAD, BACK])), 0.0)


def test_deficiency_counts_the_side_it_was_seen_from_and_the_slant() -> None:
    behind = holes([[3.0, 2.0, 2.0]], normal=(1.0, 0, 0))
    slanted = holes([[3.0, 2.0, 2.0]], normal=(-0.5, np.sqrt(0.75), 0))
    frontal = column("deficiency", context([AHEAD], holes([[3.0, 2.0, 2.0]])))[0]
    assert column("deficiency", context([AHEAD], behind))[0] == 0.0
    assert column("deficiency", context([AHEAD], slanted))[0] == pytest.approx(0.5 * frontal, rel=1e-6)


def test_deficiency_adds_up_and_stays_a_share(rng: np.random.Generator) -> None:
    one, other = [3.0, 2.2, 2.0], [3.0, 1.8, 2.1]
    values = [column("deficiency", context([AHEAD], holes(h)))[0] for h in ([one], [other], [one, other])]
    assert values[2] == pytest.approx(values[0] + values[1], rel=1e-6)
    many = rng.uniform([2, 0, 0], 4, (500, 3))
    poses = [AHEAD, BACK, *(look_along(rng.uniform(0.5, 3.5, 3), rng.normal(size=3)) for _ in range(30))]
    gain = column("deficiency", context(poses, holes(list(many), areas=0.25)))
    assert gain[0] == 1.0
    assert ((gain >= 0) & (gain <= 1)).all()
    assert ((gain > 0) & (gain < 1)).any()


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
    np.testing.assert_array_equal(refining_distance(context([AHEAD]), np.array([np.inf])), [np.inf])
    assert column("deficiency", context([AHEAD], holes([[3.0, 2.0, 2.0]]), coarse_ratio=None))[0] > 0


def test_space_known_to_be_free_to_the_end_explains_a_pixel() -> None:
    free = context([AHEAD, BACK])
    np.testing.assert_array_equal(column("pixel", free), 1.0)
    np.testing.assert_array_equal(column("unexplained", free), 0.0)
    # Unknown ahead: all rays that go forward meet it, none of those that go back.
    ahead = context([AHEAD, BACK], state=np.where(slab(2.0, 4.0), UNKNOWN, FREE), max_range=2.0)
    gain = column("unexplained", ahead)
    assert gain[0] == 1.0
    assert gain[1] == 0.0


def test_a_surface_ends_the_search_and_so_does_the_range() -> None:
    state = np.where(slab(3.0, 4.0), UNKNOWN, FREE)
    assert column("unexplained", context([AHEAD], state=state))[0] > 0.5
    walled = np.where(slab(2.4, 2.6), OCCUPIED, state)
    assert column("unexplained", context([AHEAD], state=walled))[0] == 0.0
    assert column("unexplained", context([AHEAD], state=state, max_range=1.5))[0] == 0.0


def test_covered_pixels_are_never_unexplained() -> None:
    alpha = np.ones((1, 24, 40), np.float32)
    alpha[:, :6] = 0.0
    unknown = context([AHEAD], alpha=alpha, state=UNKNOWN)
    assert column("unexplained", unknown)[0] == pytest.approx(0.25)
    assert column("pixel", unknown)[0] == pytest.approx(0.25)


def test_unexplained_is_at_most_pixel(rng: np.random.Generator) -> None:
    poses = [look_along(rng.uniform(0.5, 3.5, 3), rng.normal(size=3)) for _ in range(20)]
    # Blocks of 2 x 2 alike, as every second pixel is asked.
    alpha = rng.uniform(0, 1, (20, 12, 20)).repeat(2, axis=1).repeat(2, axis=2)
    shape = VoxelVolume(BOUNDS, VolumeConfig()).shape
    blocks = rng.choice([FREE, OCCUPIED, UNKNOWN], p=[0.9, 0.05, 0.05], size=tuple(-(-n // 4) for n in shape))
    state = np.kron(blocks, np.ones((4, 4, 4), np.uint8))[: shape[0], : shape[1], : shape[2]]
    ctx = context(poses, alpha=alpha, state=state)
    gains, pixels = column("unexplained", ctx), column("pixel", ctx)
    assert (gains <= pixels + 1e-6).all()
    assert (gains > 0).any()
    assert (gains < pixels - 0.01).any()


def test_structure_is_the_deficit_of_the_planes_in_view() -> None:
    spread = np.stack(np.meshgrid([-0.1, 0.0, 0.1], [-0.1, 0.0, 0.1]), axis=-1).reshape(-1, 2)
    facing = [
        SimpleNamespace(points=np.array([x, 2.0, 2.0]) + np.insert(spread, 0, 0.0, axis=1), normal=np.array(n, float))
        for x, n in ((3.0, (-1, 0, 0)), (3.2, (-1, 0, 0)), (0.2, (1, 0, 0)), (3.0, (1, 0, 0)))
    ]
    graph = SimpleNamespace(nodes=facing, deficit=np.array([0.1, 0.2, 0.4, 0.8]), deficiencies=holes([]))
    ctx = context([AHEAD, BACK], planes=graph)
    np.testing.assert_allclose(column("structure", ctx), [0.3, 0.4], rtol=1e-6)
    np.testing.assert_allclose(column("structure", ctx), ctx.visible @ graph.deficit, rtol=1e-6)
