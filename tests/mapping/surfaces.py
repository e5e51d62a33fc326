"""Scenes of plane surfaces, their pictures, and the maps of those pictures."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.mapping import Mapper, MapperConfig
from activestructure_gym.mapping.surface_links import BELOW, RIGHT, surface_links
from activestructure_gym.mapping.surface_samples import SurfaceSamples, samples_at, samples_between

CAMERA = PinholeCamera.from_size(80, 45)  # f = 40: pixels of a wall at 4 m are 10 cm apart
SPACING = 0.045
FORWARD = np.array([1.0, 0.0, 0.0])

Paint = Callable[[np.ndarray], np.ndarray]  # points [n, 3] -> [n] bool, black instead of grey


def plane(point: Any, normal: Any, holds: Callable[[np.ndarray], np.ndarray] | None = None) -> Any:
    """A surface of a scene: depth along rays, where ``holds`` says of the points that it is there."""
    point, normal = np.array(point, float), np.array(normal, float)

    def cast(eye: np.ndarray, rays: np.ndarray) -> np.ndarray:  # [n, 3], of z = 1 in the camera's frame -> [n]
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = ((point - eye) @ normal) / (rays @ normal)
            there = depth > 0
            if holds is not None:
                there &= holds(eye + depth[:, None] * rays)
        return np.where(there, depth, np.inf)

    return cast


def picture(
    surfaces: list, eye: Any = (0.0, 0.0, 0.0), direction: Any = FORWARD, paint: Paint | None = None,
    camera: PinholeCamera = CAMERA,
) -> Frame:  # fmt: skip
    """What a camera sees of some surfaces: grey, and black where ``paint`` says so."""
    pose = look_along(np.array(eye, float), np.array(direction, float))
    rays = camera.rays().reshape(-1, 3) @ pose[:3, :3].T
    depth = np.min([cast(pose[:3, 3], rays) for cast in surfaces], axis=0)
    depth[~np.isfinite(depth)] = 0.0
    shape = (camera.height, camera.width)
    rgb = np.full((depth.size, 3), 120, np.uint8)
    if paint is not None:
        rgb[paint(pose[:3, 3] + depth[:, None] * rays)] = 0
    return Frame(rgb.reshape(*shape, 3), depth.reshape(shape).astype(np.float32), pose, camera)


def mapped(*frames: Frame, **changes: Any) -> Mapper:
    mapper = Mapper(MapperConfig(**changes), np.random.default_rng(0))
    for frame in frames:
        mapper.observe(frame, iterations=0)
    return mapper


def linked(depth: np.ndarray, row: int, column: int, *, down: bool) -> bool:
    """Return whether a pixel is on one surface with the pixel below, or to the right."""
    return bool(surface_links(np.ascontiguousarray(depth))[row, column] & (BELOW if down else RIGHT))


def all_samples(frame: Frame, spacing: np.ndarray) -> SurfaceSamples:
    """Return the surface samples of a frame: those at its pixels, then those between pixels."""
    at = samples_at(frame, np.flatnonzero(frame.depth > 0))
    between = samples_between(frame, surface_links(frame.depth), spacing)
    return SurfaceSamples(*(np.concatenate(pair) for pair in zip(at, between)))


def dense(frame: Frame, parts: int = 8) -> np.ndarray:  # [n, 3] metres, world
    """Points of a plane within the outermost pixel centres: depth between pixels is linear in 1 / z."""
    camera, inverse = frame.camera, 1.0 / frame.depth.astype(float)
    rows, columns = np.arange(0, camera.height - 1, 1 / parts), np.arange(0, camera.width - 1, 1 / parts)
    i, j = rows.astype(int)[:, None], columns.astype(int)
    v, u = (rows % 1)[:, None], columns % 1
    depth = 1.0 / (
        (1 - v) * ((1 - u) * inverse[i, j] + u * inverse[i, j + 1])
        + v * ((1 - u) * inverse[i + 1, j] + u * inverse[i + 1, j + 1])
    )
    x = (columns + 0.5 - camera.cx) / camera.fx * depth
    y = (rows[:, None] + 0.5 - camera.cy) / camera.fy * depth
    points = np.stack([x, y, depth], axis=-1).reshape(-1, 3)
    return points @ frame.world_from_camera[:3, :3].T + frame.world_from_camera[:3, 3]


def farthest(points: np.ndarray, mapper: Mapper) -> np.ndarray:  # [n] metres to the nearest mean
    return np.asarray(cKDTree(mapper.map.means).query(points)[0])
