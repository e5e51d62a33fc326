"""Bake light per vertex: lamps and windows with soft shadows, three bounces, and an exposure.

Lamps and windows are sampled directly, since random rays would rarely hit them. Light from other surfaces is gathered
along a fixed set of directions per vertex, which is the same relative to the normal. Neighbouring vertices thus have
similar errors, and walls show no noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from activestructure_gym.scenes.procedural.furniture import Light
from activestructure_gym.scenes.procedural.mesh_builder import BuiltMesh
from activestructure_gym.scenes.raycaster import RayCaster

_STRATA = 7  # 7 x 7 rays per vertex gather the light of other surfaces
_BOUNCES = 3  # number of reflections; the third adds about 5 % of the light
_REACH = 8.0  # metres; the light of a lamp is ignored beyond
_CHUNK = 8192  # number of vertices per batch: half a million rays, 30 MB
_OFFSET = 0.008  # metres between a sample and its surface: above float32 noise, below a door's thickness
_ASIDE = np.array([0.0007, 0.0011, 0.0005])  # metres; moves samples out of the planes of faces that touch a wall
_GAMMA = 1 / 2.2  # exponent from linear light to display values
_KEY = 0.5  # linear display value of a white surface in average light
_WHITE = 1.08  # upper limit of the display factor, which very bright light approaches


@dataclass(frozen=True)
class WindowLight:
    """Hold a window pane that lights one room."""

    lower: np.ndarray  # [3] metres, corners of the (flat) pane
    upper: np.ndarray  # [3]
    inward: np.ndarray  # [3] unit
    room: np.ndarray  # [2, 3] metres, box of the room
    emission: tuple[float, float, float] = (8.0, 8.7, 9.6)  # linear RGB exitance; lamps give 0.2 to 2 at 1 m


@dataclass(frozen=True)
class _Point:
    """Hold a point light, which is one sample of a lamp or of a window pane."""

    position: np.ndarray  # [3] metres
    power: np.ndarray  # [3] linear RGB irradiance at 1 m, facing the light
    facing: np.ndarray | None = None  # [3] normal of a flat light, None = radiates in all directions
    upward: float = 1.0  # fraction radiated straight up, see `Light`


@dataclass(frozen=True)
class _Samples:
    """Hold the point and the normal at which the light of each of N vertices is computed."""

    points: np.ndarray  # [N, 3] float32
    normals: np.ndarray  # [N, 3] float32


def bake_light(
    mesh: BuiltMesh,
    caster: RayCaster,
    *,
    face_albedo: np.ndarray,  # [F, 3] linear
    lights: Sequence[Light],
    windows: Sequence[WindowLight],
) -> np.ndarray:  # [V, 3] float32
    """Return the factor of baked light on the sRGB colour of each vertex; glowing vertices get their glow instead."""
    lit = np.flatnonzero(mesh.glow == 0)
    samples = _samples(mesh, lit)
    direct = np.zeros((len(lit), 3), dtype=np.float32)
    for light in lights:
        near = np.linalg.norm(samples.points - light.position, axis=1) < _REACH
        _add_light(direct, samples, caster, np.flatnonzero(near), _lamp_points(light))
    for window in windows:
        # 0.3 m around the room's box includes its niches, but not adjacent rooms.
        inside = (samples.points > window.room[0] - 0.3) & (samples.points < window.room[1] + 0.3)
        _add_light(direct, samples, caster, np.flatnonzero(inside.all(axis=1)), _pane_points(window))
    irradiance, buried = _bounce(mesh, caster, samples, lit, direct, face_albedo)
    whole = np.zeros((len(mesh.vertices), 3), dtype=np.float32)
    whole[lit] = irradiance
    known = mesh.glow == 0
    known[lit[buried]] = False
    _fill(whole, known, mesh.faces)
    factor = np.repeat(mesh.glow[:, None], 3, axis=1)
    factor[lit] = _expose(whole[lit], np.where(buried, 0.0, _vertex_area(mesh)[lit]))
    return factor.astype(np.float32)


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:  # [N, 3] and [N, 3] or [3] -> [N]
    """Return dot products, added in a fixed order; those of NumPy round differently on other processors."""
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]


def _fill(values: np.ndarray, known: np.ndarray, faces: np.ndarray) -> None:
    """Set the light ``values`` [V, 3] of vertices inside furniture to that of near vertices of the same surface.

    ``known`` [V] is False for these vertices. Light spreads over at most three edges. Otherwise the dark inside of a
    rug or cupboard would darken the floor one face around it.
    """
    source = faces[:, [0, 1, 2, 0, 1, 2]].reshape(-1)
    target = faces[:, [1, 2, 0, 2, 0, 1]].reshape(-1)
    for _ in range(3):
        use = known[source] & ~known[target]
        ends = target[use]
        count = np.bincount(ends, minlength=len(values))
        reached = count > 0
        for k in range(3):
            total = np.bincount(ends, values[source[use], k], minlength=len(values))
            values[reached, k] = total[reached] / count[reached]
        known = known | reached


def _samples(mesh: BuiltMesh, lit: np.ndarray) -> _Samples:
    """Return the samples of the vertices ``lit`` (indices), slightly inside the faces around each and in front of them.

    A sample at the vertex itself would be in the plane of the adjacent wall and see behind it.
    """
    centroids = sum(mesh.vertices[mesh.faces[:, k]] for k in range(3)) / 3
    corners = mesh.faces.reshape(-1)
    count = np.maximum(np.bincount(corners, minlength=len(mesh.vertices)), 1)
    middle = np.stack(
        [np.bincount(corners, np.repeat(centroids[:, k], 3), minlength=len(mesh.vertices)) / count for k in range(3)],
        axis=1,
    )
    points = mesh.vertices + 0.35 * (middle - mesh.vertices) + _OFFSET * mesh.normals + _ASIDE
    return _Samples(points[lit].astype(np.float32), mesh.normals[lit])


def _lamp_points(light: Light) -> list[_Point]:
    """Return four point lights on the rim of a lamp, which are not aligned with the walls."""
    points = []
    for angle in (0.4, 2.0, 3.5, 5.1):
        offset = light.radius * np.array([np.cos(angle), np.sin(angle), 0.0])
        points.append(_Point(light.position + offset, np.array(light.power) / 4, None, light.upward))
    return points


def _pane_points(window: WindowLight) -> list[_Point]:
    """Return point lights at the centres of 3 x 3 fields of a pane; more would not change the light at the vertices."""
    extent = window.upper - window.lower
    across = int(np.argmax(extent[:2]))
    power = np.array(window.emission) * extent[across] * extent[2] / 9 / np.pi
    points = []
    for row in (1 / 6, 1 / 2, 5 / 6):
        for column in (1 / 6, 1 / 2, 5 / 6):
            position = window.lower + 0.02 * window.inward  # metres in front of the pane
            position[across] += column * extent[across]
            position[2] += row * extent[2]
            points.append(_Point(position, power, window.inward))
    return points


def _add_light(total: np.ndarray, samples: _Samples, caster: RayCaster, near: np.ndarray, points: list[_Point]) -> None:
    """Add to ``total`` the light that each sample receives from the point lights visible from it.

    ``near`` holds the indices of the samples that are considered.
    """
    for point in points:
        target = point.position.astype(np.float32)
        towards = target - samples.points[near]
        squared = _dot(towards, towards)
        length = np.sqrt(squared)
        strength = np.maximum(_dot(towards, samples.normals[near]) / length, 0)
        if point.facing is not None:
            strength *= np.maximum(-_dot(towards, point.facing.astype(np.float32)) / length, 0)
        elevation = 0.5 - 0.5 * towards[:, 2] / length  # direction from the light to the sample: 0 is down, 1 is up
        strength *= 1 - (1 - point.upward) * elevation
        strength /= np.maximum(squared, 0.3**2)  # a lamp has a size: avoids the singularity next to it
        bright = np.flatnonzero(strength * point.power.max() > 1e-3)
        blocked = caster.occluded(samples.points[near[bright]], np.broadcast_to(target, (len(bright), 3)))
        seen = bright[~blocked]
        total[near[seen]] += (strength[seen, None] * point.power).astype(np.float32)


def _directions(strata: int) -> np.ndarray:  # [strata^2, 3] float32
    """Return strata x strata unit directions around +z, distributed in proportion to their cosine to +z."""
    cell = (np.arange(strata) + 0.5) / strata
    share, turn = np.meshgrid(cell, cell, indexing="ij")
    radius = np.sqrt(share).reshape(-1)
    # Rows of directions are rotated against each other, so that directions do not line up.
    angle = (2 * np.pi * (turn + 0.382 * np.arange(strata)[:, None])).reshape(-1)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1 - radius**2)], axis=1).astype(np.float32)


def _bounce(
    mesh: BuiltMesh,
    caster: RayCaster,
    samples: _Samples,
    lit: np.ndarray,
    direct: np.ndarray,
    face_albedo: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:  # [N, 3] irradiance, [N] bool
    """Return direct plus reflected light for each of N samples, and which samples are inside furniture.

    ``lit`` [N] are the vertices of the samples, ``direct`` [N, 3] their light from lamps and windows, and
    ``face_albedo`` [F, 3] the linear reflectance of the faces.
    """
    corner = mesh.vertices[mesh.faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    directions = _directions(_STRATA)
    seen = np.empty((len(directions), len(lit)), dtype=np.int32)
    for start in range(0, len(lit), _CHUNK):
        part = slice(start, start + _CHUNK)
        n = samples.normals[part]
        helper = np.where(np.abs(n[:, 2:]) < 0.9, np.array([0, 0, 1], np.float32), np.array([1, 0, 0], np.float32))
        tangent = np.cross(helper, n)
        tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
        axes = (tangent, np.cross(n, tangent), n)
        rays = sum(directions[:, k, None, None] * axis[None] for k, axis in enumerate(axes))  # [D, n, 3]
        face = caster.cast(np.broadcast_to(samples.points[part], rays.shape).reshape(-1, 3), rays.reshape(-1, 3)).face
        # Back faces are seen only from inside furniture, where it is dark. They get the index F, whose light is 0.
        away = _dot(normal[face], rays.reshape(-1, 3))
        face[(face < 0) | (away > 0)] = len(mesh.faces)
        seen[:, part] = face.reshape(len(directions), -1)
    whole = np.zeros((len(mesh.vertices), 3), dtype=np.float32)
    exitance = np.zeros((len(mesh.faces) + 1, 3), dtype=np.float32)
    irradiance = direct
    for _ in range(_BOUNCES):
        whole[lit] = irradiance
        a, b, c = (whole[mesh.faces[:, k]] for k in range(3))
        exitance[:-1] = face_albedo * (a + b + c) / (3 * len(directions))
        irradiance = direct.copy()
        for faces in seen:
            irradiance += exitance[faces]
    return irradiance, (seen == len(mesh.faces)).mean(axis=0) > 0.5


def _vertex_area(mesh: BuiltMesh) -> np.ndarray:  # [V] m^2
    """Return the area that belongs to each vertex: a third of the area of its faces."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]].astype(np.float64) for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    return np.bincount(mesh.faces.reshape(-1), np.repeat(area / 3, 3), minlength=len(mesh.vertices))


def _expose(irradiance: np.ndarray, area: np.ndarray) -> np.ndarray:
    """Return factors on the sRGB colours of N vertices from their irradiance [N, 3] (linear).

    The steps are half a white balance, a fixed average brightness, soft compression of bright values, and gamma.
    ``area`` [N] in m^2 weights the vertices in the averages. Since (albedo * light)^(1/2.2) = albedo^(1/2.2) *
    light^(1/2.2), only light is converted.
    """
    share = area / area.sum()
    # float64, since exponentials differ in the last bits between processors; rounded to float32 they rarely do.
    irradiance = irradiance.astype(np.float64)
    luminance = _dot(irradiance, np.array([0.2126, 0.7152, 0.0722]))
    key = np.exp((share * np.log(luminance + 1e-3)).sum())
    tone = (share[:, None] * irradiance).sum(axis=0)
    balance = np.sqrt(tone / tone.mean())
    exposed = _KEY * irradiance / (key * balance)
    return _WHITE * ((1 - np.exp(-exposed / _WHITE)) + 0.003) ** _GAMMA
