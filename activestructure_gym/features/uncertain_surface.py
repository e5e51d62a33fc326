"""Estimate the uncertainty of the map's surface, and find connected uncertain regions: the view targets of ANM.

ANM and ANM-S perturb the weights W of a network f of the signed distance. The uncertainty of a surface point is
u(x) = 1/M sum over m of |f(x; W) - f(x; W + delta_m)|. In this module, W are the parameters of the Gaussians, and f is
the rendered depth. Sources: [anm], [activeinr, code], [anm_s, code].
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from activestructure_gym.features.context import FeatureContext
from activestructure_gym.mapping.frustum_culling import MapParts
from activestructure_gym.mapping.gaussian_map import LOG_SCALE, MEAN, OPACITY_LOGIT, QUATERNION
from activestructure_gym.volume import FREE, VoxelVolume

PERTURBATIONS = 20  # M, number of perturbed maps
VIEWS = 12  # maximum number of candidates from which each perturbed map is rendered, see `covering_views`
STEP = 0.001  # metres, standard deviation of the perturbation of a mean per axis; too small to change the depth order
RELATIVE_STEP = 0.01  # standard deviation of the perturbation of log-scales, quaternions and opacity logits
MIN_SHARE = 0.005  # minimum size of a cluster, as a share of the uncertain voxels
STAND_OFF = 0.5  # metres along the normal from the surface to the target of a view
_STRIDE = 4  # pixels between the tested pixels in `covering_views`
_NEAR = 2  # voxels, half the side length of the cube whose free voxels determine a normal
_SEED = 0


@dataclass(frozen=True)
class Surface:
    """Hold the V surface voxels of the map; ANM uses the vertices of a mesh with edges of 0.1 m instead."""

    voxels: np.ndarray  # [V, 3] int64
    points: np.ndarray  # [V, 3] metres, world: mean surface point in the voxel
    normals: np.ndarray  # [V, 3] unit, towards free space
    uncertainty: np.ndarray  # [V] u: metres by perturbation, without unit by `by_proxy`

    def below(self, height: float) -> Surface:
        """Return the voxels whose surface point has z below ``height``, in metres (world)."""
        low = self.points[:, 2] < height
        return Surface(self.voxels[low], self.points[low], self.normals[low], self.uncertainty[low])


@dataclass(frozen=True)
class Clusters:
    """Hold the C connected uncertain regions of a surface, largest first."""

    shares: np.ndarray  # [C] number of voxels of the region, as a share of all surface voxels
    targets: np.ndarray  # [C, 3] metres: camera position, mean of v + 0.5 n over points v with normals n
    centres: np.ndarray  # [C, 3] metres: mean of v
    directions: np.ndarray  # [C, 3] unit view directions, -mean n; 0 if the normals cancel


def by_perturbing_means(context: FeatureContext) -> Surface:
    """Return the surface, with the uncertainty from perturbed means of the Gaussians.

    This corresponds to ANM-S, which perturbs only the distance head of its network.
    """
    return _perturbed(context, everything=False)


def by_perturbing_all(context: FeatureContext) -> Surface:
    """Return the surface, with the uncertainty from perturbing all parameters of the Gaussians except colours (ANM).

    Colours do not change the rendered depth.
    """
    return _perturbed(context, everything=True)


def by_proxy(context: FeatureContext) -> Surface:
    """Return the surface with u = sqrt(sum o_k^2) / sum o_k over the Gaussians k of a voxel, without rendering.

    This is a first-order approximation of the perturbation. The rendered depth is a mean of the depths of the
    Gaussians, weighted approximately by their opacities o_k. If each depth has an independent error with standard
    deviation s, the mean has the standard deviation s u. For n equal Gaussians, u = 1 / sqrt(n).
    """
    gaussians, volume = context.mapper.map, context.volume
    inside = volume.contains(gaussians.means)
    means, opacity = gaussians.means[inside], gaussians.opacities[inside].astype(np.float64)
    flat = np.ravel_multi_index(tuple(volume.voxel_of(means).T), volume.shape)
    voxel_ids, place = np.unique(flat, return_inverse=True)
    total = np.bincount(place, weights=opacity)
    squares = np.bincount(place, weights=opacity**2)
    points = np.stack([np.bincount(place, weights=opacity * means[:, axis]) for axis in range(3)], axis=1)
    solid = total > context.coverage_alpha
    return _with_normals(
        volume, voxel_ids[solid], points[solid] / total[solid, None], np.sqrt(squares[solid]) / total[solid]
    )


def _perturbed(context: FeatureContext, *, everything: bool) -> Surface:
    """Return the surface; u of a voxel is the mean absolute depth change over M perturbations and its pixels.

    With ``everything``, all parameters except colours are perturbed, otherwise only the means.
    """
    volume, camera = context.volume, context.camera
    views = covering_views(context)
    poses = context.world_from_camera[views]
    parameters, count = MapParts(context.mapper.map).in_view(camera, poses)
    alpha = context.alpha[views]
    covered = alpha > context.coverage_alpha
    depth = context.depth[views] / np.maximum(alpha, 1e-6)
    rng = np.random.default_rng([_SEED, len(context.mapper.keyframes)])  # anew at every decision, as in the original
    change = np.zeros(int(covered.sum()))
    for _ in range(PERTURBATIONS):
        moved = parameters.copy()
        moved[MEAN, :count] += np.float32(STEP) * rng.standard_normal((3, count), np.float32)
        if everything:
            for rows in (QUATERNION, LOG_SCALE, slice(OPACITY_LOGIT, OPACITY_LOGIT + 1)):
                noise = rng.standard_normal(moved[rows, :count].shape, np.float32)
                moved[rows, :count] += np.float32(RELATIVE_STEP) * noise
        shown, opaque = context.mapper.rasterizer.render_depth_alpha(moved, count, camera, poses)
        change += np.abs(shown[covered] / np.maximum(opaque[covered], 1e-6) - depth[covered])
    points = _in_world(camera.rays()[None] * depth[..., None], poses)[covered]
    inside = volume.contains(points)
    points, change = points[inside], change[inside] / PERTURBATIONS
    flat = np.ravel_multi_index(tuple(volume.voxel_of(points).T), volume.shape)
    voxel_ids, place = np.unique(flat, return_inverse=True)
    pixels = np.bincount(place)
    means = np.stack([np.bincount(place, weights=points[:, axis]) for axis in range(3)], axis=1) / pixels[:, None]
    return _with_normals(volume, voxel_ids, means, np.bincount(place, weights=change) / pixels)


def covering_views(context: FeatureContext) -> np.ndarray:  # [<= VIEWS] rows
    """Return the rows of up to `VIEWS` candidates that together see most surface voxels.

    They are chosen greedily: each sees the most voxels that are not visible from the candidates chosen before.
    """
    volume, at = context.volume, slice(_STRIDE // 2, None, _STRIDE)
    alpha, rays = context.alpha[:, at, at], context.camera.rays()[at, at]
    depth = context.depth[:, at, at] / np.maximum(alpha, 1e-6)
    points = _in_world(rays[None] * depth[..., None], context.world_from_camera)
    good = (alpha > context.coverage_alpha) & volume.contains(points)
    view = np.nonzero(good)[0]
    voxel_ids = np.ravel_multi_index(tuple(volume.voxel_of(points[good]).T), volume.shape)
    _, place = np.unique(voxel_ids, return_inverse=True)
    sees: np.ndarray = np.zeros((len(alpha), int(place.max(initial=-1)) + 1), dtype=bool)
    sees[view, place] = True
    chosen: list[int] = []
    while len(chosen) < VIEWS:
        new = sees.sum(axis=1)
        if not new.any():
            break
        chosen.append(int(new.argmax()))
        sees &= ~sees[chosen[-1]]
    return np.array(chosen, dtype=np.int64)


def clusters(surface: Surface, keep: float) -> Clusters:
    """Return the connected regions (6 neighbours) of the most uncertain fraction ``keep`` of the surface.

    The originals join triangles that share an edge. Triangles of two cells of marching cubes share one only if the
    cells have a common face. Regions with less than `MIN_SHARE` of the uncertain voxels are left out.
    """
    total = len(surface.voxels)
    if not total:
        return Clusters(np.zeros(0), *(np.zeros((0, 3)) for _ in range(3)))
    kept = np.argsort(-surface.uncertainty, kind="stable")[: int(np.ceil(keep * total))]
    voxels = surface.voxels[kept]
    lower = voxels.min(axis=0)
    grid = np.zeros(voxels.max(axis=0) - lower + 1, dtype=bool)
    grid[tuple((voxels - lower).T)] = True
    label = ndimage.label(grid)[0][tuple((voxels - lower).T)] - 1
    size = np.bincount(label)
    order = np.argsort(-size, kind="stable")
    order = order[size[order] >= MIN_SHARE * len(kept)]

    def mean(values: np.ndarray) -> np.ndarray:  # [V, 3] -> [C, 3]
        sums = np.stack([np.bincount(label, weights=values[kept, axis]) for axis in range(3)], axis=1)
        return sums[order] / size[order, None]

    centres, normals = mean(surface.points), mean(surface.normals)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    directions = np.where(length > 1e-6, -normals / np.maximum(length, 1e-6), 0.0)
    return Clusters(size[order] / total, centres + STAND_OFF * normals, centres, directions)


def _with_normals(volume: VoxelVolume, voxel_ids: np.ndarray, points: np.ndarray, uncertainty: np.ndarray) -> Surface:
    voxels = np.stack(np.unravel_index(voxel_ids, volume.shape), axis=1)
    normals = free_side(volume, voxels)
    good = normals.any(axis=1)
    return Surface(voxels[good], points[good], normals[good], uncertainty[good])


def free_side(volume: VoxelVolume, voxels: np.ndarray) -> np.ndarray:  # [V, 3] -> [V, 3] unit, 0 where none
    """Return the normal of each voxel: the unit mean direction to the free voxels within two voxels of it.

    It is 0 if there are no free voxels, or if free voxels on opposite sides cancel. ``voxels`` are indices.
    """
    free = np.pad(volume.state == FREE, _NEAR)
    steps = np.stack(np.meshgrid(*[np.arange(-_NEAR, _NEAR + 1)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    total = np.zeros((len(voxels), 3))
    for step in steps[steps.any(axis=1)]:
        total += free[tuple((voxels + _NEAR + step).T)][:, None] * (step / np.linalg.norm(step) ** 2)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.where(length > 0.1, total / np.maximum(length, 1e-9), 0.0)


def _in_world(points: np.ndarray, poses: np.ndarray) -> np.ndarray:  # [C, h, w, 3] camera, [C, 4, 4] -> [C, h, w, 3]
    rows: np.ndarray = points.reshape(len(points), points.shape[1] * points.shape[2], 3).astype(np.float64)
    return (rows @ poses[:, :3, :3].transpose(0, 2, 1) + poses[:, None, :3, 3]).reshape(points.shape)
