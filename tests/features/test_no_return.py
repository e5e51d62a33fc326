"""Gains do not remain where rays have no return and no view finds a surface."""

from __future__ import annotations

import copy
import dataclasses
import functools
import sys

import numpy as np
import pytest

from activestructure_gym.config import configure
from activestructure_gym.features import FEATURES, FeatureContext, evaluate_features
from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.mapping import Mapper
from activestructure_gym.planes import PlaneSceneGraph
from activestructure_gym.volume import VoxelVolume

SENSOR, CANDIDATES = PinholeCamera.from_size(96, 54), PinholeCamera.from_size(48, 27)
RANGE = 10.0  # metres, range of the sensor
BOUNDS = np.array([[0.0, 0.0, 0.0], [6.0, 3.0, 2.5]])  # the room ends at x = 4; the rest is outside the house
ROOM = [  # floor, ceiling and three walls
    ([0, 0, -0.1], [4, 3, 0]), ([0, 0, 2.5], [4, 3, 2.6]),
    ([-0.1, 0, 0], [0, 3, 2.5]), ([0, -0.1, 0], [4, 0, 2.5]), ([0, 3, 0], [4, 3.1, 2.5]),
]  # fmt: skip
WALL = ([4, 0, 0], [4.1, 3, 2.5])
# The east side of the room by its boxes, and the rectangle (y, z) on the plane x = 4 that returns nothing.
SIDES = {
    "closed": ([WALL], None),
    "crack": ([([4, 0, 0], [4.1, 3, 2.38])], None),
    "window": ([([4, 0, 0], [4.1, 3, 0.9]), ([4, 0, 1.9], [4.1, 3, 2.5]),
                ([4, 0, 0], [4.1, 1, 2.5]), ([4, 2, 0], [4.1, 3, 2.5])], None),
    "open side": ([], None),
    "dark surface": ([WALL], ((1.2, 1.0), (1.8, 1.4))),
    "mirror": ([WALL], ((0.9, 0.6), (2.1, 1.8))),
}  # fmt: skip


def pose(x: float, y: float, yaw: float, pitch: float) -> np.ndarray:
    """A view at 1.2 m towards the east side; angles in degrees."""
    yaw, pitch = np.radians(yaw), np.radians(pitch)
    return look_along(
        np.array([x, y, 1.2]), np.array([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)])
    )


KEYFRAMES = [pose(x, y, 0.0, pitch) for x in (0.8, 2.4) for y in (0.7, 1.5, 2.3) for pitch in (-35.0, 0.0, 35.0)]
VIEWS = np.stack([pose(x, y, 0.0, pitch) for x in (1.2, 1.8) for y in (1.1, 1.9) for pitch in (5.0, 25.0)])


# Columns that grow with the space a view can show. Others are compared with these, or do not depend on rays.
MARCHING = ("hole_area", "unknown_volume", "gs_planner", "hgs_coverage", "magician")
COUNTING = ("unexplored", "confidence", "r3_recon")  # count unobserved voxels in front of the rendered surface
COMBINED = ("hgs_planner", "hgs_planner_raw")  # of `hgs_coverage` and the Fisher information


@pytest.fixture(scope="module")
def seen(cast_boxes):
    """Return a function that makes, once for each side, the context after keyframes that all see the east side."""
    return functools.cache(functools.partial(context_of, cast_boxes))


def context_of(cast_boxes, side: str) -> FeatureContext:
    boxes, silent = SIDES[side]
    caster = cast_boxes(*ROOM, *boxes)
    mapper = Mapper(configure("fast").mapper, np.random.default_rng(0))
    volume, planes = VoxelVolume(BOUNDS), PlaneSceneGraph()
    for at in KEYFRAMES:
        frame = captured(caster, at, silent)
        mapper.observe(frame, iterations=0)
        volume.integrate(frame, sensor_range=RANGE)
        planes.integrate(frame)
    for view in VIEWS:
        volume.mark_free_sphere(view[:3, 3], 0.4)  # where the agent can be
    return FeatureContext(
        mapper=mapper, volume=volume, planes=planes, camera=CANDIDATES, bounds=BOUNDS, coverage_alpha=0.5,
        max_range=RANGE, world_from_camera=VIEWS,
    )  # fmt: skip


def captured(caster, world_from_camera: np.ndarray, silent) -> Frame:
    rays = SENSOR.rays().reshape(-1, 3) @ world_from_camera[:3, :3].T
    origin = world_from_camera[:3, 3]
    depth = caster.cast(origin, rays).distance
    points = origin + np.where(np.isfinite(depth), depth, 0.0)[:, None] * rays
    lost = ~(depth <= RANGE)
    if silent is not None:
        lost |= (np.abs(points[:, 0] - 4.0) < 0.01) & ((points[:, 1:] > silent[0]) & (points[:, 1:] < silent[1])).all(1)
    depth = np.where(lost, 0.0, depth).astype(np.float32).reshape(SENSOR.height, SENSOR.width)
    rgb = np.random.default_rng(1).integers(60, 200, (*depth.shape, 3)).astype(np.uint8)
    return Frame(rgb, depth, world_from_camera, SENSOR)


def gain(name: str, context: FeatureContext, *, forget: bool = False) -> float:
    """Return the sum over the views; ``forget`` clears the record of rays without a return first."""
    volume = context.volume
    if forget:
        volume = copy.copy(volume)
        volume.no_return = np.zeros(volume.shape, bool)
    return float(evaluate_features((name,), dataclasses.replace(context, volume=volume))[:, 0].sum())


@pytest.mark.parametrize("name", MARCHING + COUNTING)
@pytest.mark.parametrize("side", [side for side in SIDES if side != "closed"])
def test_a_view_has_no_gain_where_keyframes_saw_no_return(seen, name: str, side: str) -> None:
    nothing, forgotten, known = gain(name, seen("closed")), gain(name, seen(side), forget=True), gain(name, seen(side))
    if (name, side) not in {("magician", "crack"), ("magician", "window")}:  # no plane extends there
        assert forgotten > 1.2 * nothing
    assert known - nothing <= 0.05 * (forgotten - nothing)


def test_every_feature_that_marches_rays_is_tested_here() -> None:
    marching = {name for name in FEATURES if "grid_rays" in vars(sys.modules[FEATURES.get(name).compute.__module__])}
    assert marching == {*MARCHING, *COMBINED}


def test_without_such_rays_nothing_is_recorded_and_space_not_yet_seen_still_counts(seen) -> None:
    assert not seen("closed").volume.no_return.any()
    ahead = seen("open side")
    back = dataclasses.replace(ahead, world_from_camera=np.stack([look_along(v[:3, 3], -v[:3, 2]) for v in VIEWS]))
    for name in ("hole_area", "unknown_volume", "gs_planner"):
        assert gain(name, back) > 10 * gain(name, ahead)
