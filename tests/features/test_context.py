"""Objects that features keep: made once per episode, called around an event's steps, copied with the map."""

from __future__ import annotations

import copy
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from activestructure_gym.features import FeatureContext
from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.mapping import GaussianMap, Mapper, MapperConfig
from activestructure_gym.mapping.config import MAPPERS
from activestructure_gym.mapping.registry import mapper_config

CAMERA = PinholeCamera.from_size(32, 18)
WALL = Frame(np.full((18, 32, 3), 90, np.uint8), np.full((18, 32), 2.0, np.float32), np.eye(4), CAMERA)


class Calls:
    """Notes when it is called, and how many Gaussians there are then."""

    def __init__(self, gaussians: GaussianMap) -> None:
        self.map = gaussians
        self.seen: list[tuple[str, int]] = []

    def before_steps(self) -> None:
        self.seen.append(("before", self.map.count))

    def after_steps(self) -> None:
        self.seen.append(("after", self.map.count))


def calls(context: FeatureContext) -> Calls:
    return Calls(context.mapper.persistent_map)


def step_of(mapper: Mapper) -> FeatureContext:
    unused = cast(Any, SimpleNamespace())
    return FeatureContext(mapper, unused, unused, CAMERA, np.zeros((2, 3)), 0.5, 5.0, np.zeros((0, 4, 4)))


def test_an_object_is_made_once_per_episode_and_another_one_in_the_next() -> None:
    mapper = Mapper(MapperConfig(iterations=1), np.random.default_rng(0))
    kept = step_of(mapper).episode(calls)
    assert step_of(mapper).episode(calls) is kept  # another step's context
    assert step_of(Mapper(mapper.config, np.random.default_rng(0))).episode(calls) is not kept


# co_slam makes its Gaussians anew after every event, so no feature can follow them.
@pytest.mark.parametrize("name", sorted(name for name in MAPPERS if name != "co_slam"))
def test_it_is_called_around_the_steps_of_every_event_from_then_on(name: str) -> None:
    mapper = mapper_config(name).make(np.random.default_rng(0), np.array([[-3.0] * 3, [3.0] * 3]))
    mapper.observe(WALL, iterations=1)
    kept = step_of(mapper).episode(calls)
    assert kept.seen == []
    mapper.observe(WALL, iterations=1)
    mapper.refine(1)
    assert [when for when, _ in kept.seen] == ["before", "after"] * 2
    assert kept.seen[0][1] >= kept.seen[1][1] > 0  # seeded before the steps; some may be gone after them


def test_a_copy_of_the_mapper_has_a_copy_that_follows_the_copied_map() -> None:
    mapper = Mapper(MapperConfig(iterations=1), np.random.default_rng(0))
    kept = step_of(mapper).episode(calls)
    other = copy.deepcopy(mapper)
    copied = step_of(other).episode(calls)
    assert copied is not kept and copied.map is other.map and kept.map is mapper.map
    other.observe(WALL)
    assert len(copied.seen) == 2 and kept.seen == []
