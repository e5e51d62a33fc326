"""How far Gaussians moved in the last mapping event, against the means before and after."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from activestructure_gym.features import FeatureContext
from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.mapping import Mapper, MapperConfig
from activestructure_gym.policies.rt_guide.features import displacement
from activestructure_gym.sensors import Frame

CAMERA = PinholeCamera.from_size(64, 36, 90.0)


def displacement_of(mapper: Mapper) -> np.ndarray:
    """Of the episode of this mapper, as the features of a new step read it."""
    unused = cast(Any, SimpleNamespace())
    context = FeatureContext(mapper, unused, unused, CAMERA, np.zeros((2, 3)), 0.5, 5.0, np.zeros((0, 4, 4)))
    return displacement(context)


@pytest.fixture(scope="module")
def wall() -> Frame:
    rgb = np.random.default_rng(1).integers(0, 256, (36, 64, 3)).astype(np.uint8)
    return Frame(rgb, np.full((36, 64), 2.0, np.float32), np.eye(4), CAMERA)


def test_displacement_is_the_way_of_the_last_event_and_changes_nothing(wall: Frame) -> None:
    def run(*, asked: bool) -> tuple[Mapper, list[np.ndarray]]:
        mapper, seen = Mapper(MapperConfig(iterations=3, mean_rate=3e-5), np.random.default_rng(0)), []
        mapper.observe(wall)
        if asked:
            assert not displacement_of(mapper).any()  # nobody has looked yet
        before = mapper.map.means
        mapper.observe(wall)
        if asked:
            seen = [before, mapper.map.means, displacement_of(mapper)]
        return mapper, seen

    mapper, (before, after, moved) = run(asked=True)
    assert len(before) == len(after)  # the same Gaussians in the same columns
    np.testing.assert_allclose(moved, np.linalg.norm(after - before, axis=1), atol=1e-6)
    assert moved.max() > 0
    other, _ = run(asked=False)
    np.testing.assert_array_equal(other.map.parameters, mapper.map.parameters)


def test_displacement_follows_a_gaussian_and_stays_where_nothing_touches_it(wall: Frame) -> None:
    mapper = Mapper(MapperConfig(iterations=3), np.random.default_rng(0))
    mapper.observe(wall)
    displacement_of(mapper)
    mapper.observe(wall)
    names, moved = mapper.map.ids[: mapper.map.count].copy(), displacement_of(mapper).copy()
    mapper.map.keep(np.random.default_rng(0).uniform(size=len(names)) < 0.5)
    kept = mapper.map.ids[: mapper.map.count]
    np.testing.assert_array_equal(displacement_of(mapper), moved[np.searchsorted(names, kept)])
    mapper.refine(0)  # an event without a step
    np.testing.assert_array_equal(displacement_of(mapper), moved[np.searchsorted(names, kept)])
    turned = look_along(np.zeros(3), np.array([0.0, 0.0, -1.0]))
    count = mapper.map.count
    mapper.observe(Frame(wall.rgb, wall.depth, turned, CAMERA), iterations=1)  # its step sees the other side only
    np.testing.assert_array_equal(displacement_of(mapper)[:count], moved[np.searchsorted(names, kept)])
