"""Compute RT-GuIDE's feature: the motion of Gaussians during optimisation, per view and region, without rendering."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from activestructure_gym.features.context import FeatureContext
from activestructure_gym.features.registry import FEATURES
from activestructure_gym.features.unexplored import sums_in_front
from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.policies.rt_guide.displacement import Displacement

CUBOID_M = 2.5  # metres, side of the cubes that are the regions
_SPREAD = 0.5  # standard deviations from the mean displacement to the limits of the sets H and L (`moving_in_view`)
_LOW = 1.0  # weight of the set L


@FEATURES.register(
    "rt_guide",
    columns=("", "region", "cuboid"),
    unit=("share of the Gaussians, net", "m", "index"),
    low=(-1.0, 0.0, 0.0),
    high=(1.0, np.inf, np.inf),
)
def rt_guide(context: FeatureContext) -> np.ndarray:  # [K, 3]
    """Compute xi of the view (share of the Gaussians), Omega of its cuboid (m), and the index of the cuboid.

    xi is `moving_in_view`. The view looks at the cube of 2.5 m that contains the point on its axis at the
    `viewing_distance`. Omega is the mean uncertainty (`displacement`) of the Gaussians in it; 0 without Gaussians.
    """
    regions = _regions(context)
    return np.column_stack([moving_in_view(context), regions.uncertainty, regions.cuboid])


def displacement(context: FeatureContext) -> np.ndarray:  # [N] float32 metres
    """Return how far each Gaussian moved in the last mapping event that moved it, in metres; 0 without one.

    Events before the first call of the episode are not recorded.
    """
    return context.episode(_displacement).metres()


def _displacement(context: FeatureContext) -> Displacement:
    return Displacement(context.mapper.persistent_map)


def moving_in_view(context: FeatureContext) -> np.ndarray:  # [K] in -1..1
    """Return xi = (#H - 1.0 #L) / #Gaussians, where H and L are Gaussians in the frustum ([rt_guide]).

    The uncertainty of a Gaussian is |change of its mean| in the last mapping event that changed it. In H it exceeds the
    mean over all Gaussians by half a standard deviation; in L it is below the mean by as much. Gaussians beyond the
    depth range of the volume are left out; occlusion is not tested.
    """
    moved = displacement(context).astype(np.float64)
    if not len(moved):
        return np.zeros(len(context.world_from_camera))
    middle, spread = moved.mean(), _SPREAD * moved.std()
    weights = (moved > middle + spread) - _LOW * (moved < middle - spread)
    chosen, camera = weights != 0, context.camera
    reach = min(context.max_range, context.volume.config.max_range)
    shape = (len(context.world_from_camera), camera.height, camera.width)
    anywhere = np.broadcast_to(np.float32(reach), shape).copy()
    points = context.mapper.map.means[chosen].astype(np.float64)
    in_view = sums_in_front(points, weights[chosen], anywhere, context)[:, 0]
    return in_view / len(moved)


@dataclass(frozen=True)
class _Regions:
    """Hold the cuboid at which each of K candidates looks, and its mean uncertainty."""

    uncertainty: np.ndarray  # [K] metres
    cuboid: np.ndarray  # [K] int64


def viewing_distance(camera: PinholeCamera) -> float:  # metres
    """Return the shortest distance at which a camera sees the whole width and height of a cuboid around its middle."""
    return 0.5 * CUBOID_M * max(camera.fx / (0.5 * camera.width), camera.fy / (0.5 * camera.height))


def _regions(context: FeatureContext) -> _Regions:
    """Return the index of the cuboid of each candidate, and the mean uncertainty of the Gaussians in it."""
    volume, moved = context.volume, displacement(context).astype(np.float64)
    shape = np.ceil(np.array(volume.state.shape) * volume.config.voxel_size / CUBOID_M).astype(int)

    def number(points: np.ndarray) -> np.ndarray:
        cells = np.floor((points - volume.origin) / CUBOID_M).astype(int)
        return np.ravel_multi_index(tuple(np.clip(cells, 0, shape - 1).T), tuple(shape))

    of_gaussians = number(context.mapper.map.means.astype(np.float64))
    size = int(shape.prod())
    counts = np.bincount(of_gaussians, minlength=size)
    mean = np.bincount(of_gaussians, weights=moved, minlength=size) / np.maximum(counts, 1)
    axis = context.world_from_camera[:, :3, 2]
    seen = number(context.world_from_camera[:, :3, 3] + viewing_distance(context.camera) * axis)
    return _Regions(mean[seen], seen)
