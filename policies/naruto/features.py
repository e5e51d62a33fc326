"""NARUTO's goal score and look-at list ([naruto]), with the uncertainty that its loss tends to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from activestructure_gym.features.context import FeatureContext
from activestructure_gym.features.registry import FEATURES
from activestructure_gym.features.voxel_errors import squared_depth_error, voxel_sums
from activestructure_gym.mapping import KeyframeMapper
from activestructure_gym.volume import FREE, VoxelVolume

INITIAL = float(np.log1p(np.exp(3.0)) + 0.01)  # sigma of a place that no ray has taught anything
FLOOR = 0.01  # the least sigma
POOL = 4000  # most uncertain voxels, of which TARGETS are kept
TARGETS = 300
POOL_SHARE = 0.035  # of the grid's voxels, where that is less: 4000 of room0's 80 x 48 x 30
TARGET_SHARE = 0.075  # of the pool
MIN_TARGET_DISTANCE_M, MAX_TARGET_DISTANCE_M = 0.5, 2.0  # metres between a goal and the targets it may count
SAMPLES = 30  # places between goal and target that must be free
LISTED = 10  # targets of the look-at list


@dataclass(frozen=True)
class Targets:
    """The uncertain places of a step and who sees them."""

    positions: np.ndarray  # [T, 3] metres, world, the most uncertain first
    sigma: np.ndarray  # [T] m^2
    seen: np.ndarray  # [K, T] bool, from every candidate's position


@FEATURES.register("naruto", unit="sum of uncertainties", low=0.0)
def naruto(context: FeatureContext) -> np.ndarray:  # [K] >= 0
    """S(g) = sum over t in T of sigma(t) [.5 < |g - t| < 2 m] [all 30 samples of g..t are free].

    g is the candidate's position; its direction plays no part. That g itself is safe is the candidate pool's business.
    Source: [naruto, code].
    """
    targets = context.once(find_targets)
    return targets.seen @ targets.sigma


@FEATURES.register("naruto_look", columns=[f"{rank}_{axis}" for rank in range(LISTED) for axis in "xyz"], unit="m")
def naruto_look(context: FeatureContext) -> np.ndarray:  # [K, 30] metres, world
    """The look-at list of a goal at the candidate's position: LISTED places, x, y and z of each.

    The list holds the most uncertain targets that are seen from there. Behind its end: the candidate's own position.
    """
    targets = context.once(find_targets)
    listed = np.repeat(context.world_from_camera[:, None, :3, 3], LISTED, axis=1)
    rank = np.cumsum(targets.seen, axis=1) - 1  # the targets stand in their order
    row, target = np.nonzero(targets.seen & (rank < LISTED))
    listed[row, rank[row, target]] = targets.positions[target]
    return listed.reshape(len(listed), 3 * LISTED)


def find_targets(context: FeatureContext) -> Targets:
    """T and its visibility from every candidate; share it by ``context.once(find_targets)``."""
    return targets_from(context.mapper, context.volume, context.world_from_camera[:, :3, 3])


def targets_from(mapper: KeyframeMapper, volume: VoxelVolume, standing: np.ndarray) -> Targets:  # [K, 3] metres
    """T, and which of it is seen from each place."""
    voxels, sigma = uncertainty(volume, *voxel_sums(mapper, volume, squared_depth_error))
    voxel_ids = np.asarray(np.ravel_multi_index(tuple(voxels.T), volume.shape))
    kept = chosen(voxel_ids, sigma, volume.state.size)
    positions = volume.center_of(voxels[kept])
    places, place_of = np.unique(standing, axis=0, return_inverse=True)
    return Targets(positions, sigma[kept], visible(volume, places, positions)[place_of.ravel()])


def uncertainty(
    volume: VoxelVolume,
    errors: np.ndarray,  # [X, Y, Z] m^2, sum of the squared depth errors of what was seen in each voxel
    pixels: np.ndarray,  # [X, Y, Z] of how many pixels
) -> tuple[np.ndarray, np.ndarray]:  # [V, 3] voxels near the surface, sigma [V]
    """sigma(x) = mean squared depth error of the surface at x, at least `FLOOR`, in front of the surface; 0 elsewhere.

    [naruto, code] learns sigma = softplus(u) + .01 from (D - D_measured)^2 / (2 U) + 1/2 log U with U = sum w^2 sigma
    over a ray, one step of rate 1 per keyframe: it tends to the mean squared error of the rendered depth, and where no
    ray has come it stays `INITIAL`, softplus(3) + .01. This is what it tends to, with the weight of a ray in one place.

    Near the surface are the free voxels beside one that is not free: there a surface is, or for all one knows may be.
    At x are what was seen in x, in the voxels beside it that are not free, and in those beside these: a voxel that the
    surface merely touches can stay unknown. A surface that none of the pixels saw has the mean of all that they saw.
    """
    free = volume.state == FREE
    voxels = np.argwhere(free & (_beside((~free).astype(np.float64)) > 0))
    at = tuple(voxels.T)

    def around(values: np.ndarray) -> np.ndarray:  # [X, Y, Z] -> [V]
        behind = np.where(free, 0.0, values)
        behind = np.where(free, 0.0, behind + _beside(behind))
        return np.asarray(values[at] + _beside(behind)[at])

    looks = around(pixels)
    mean = errors.sum() / max(pixels.sum(), 1.0)
    unmeasured = np.where(around(volume.occupied.astype(np.float64)) > 0, max(mean, FLOOR), INITIAL)
    return voxels, np.where(looks > 0, np.maximum(around(errors) / np.maximum(looks, 1.0), FLOOR), unmeasured)


def _beside(values: np.ndarray) -> np.ndarray:  # [X, Y, Z] -> sum over the 6 neighbours
    total = np.zeros_like(values)
    for axis in range(3):
        ahead, back = ([slice(None)] * 3 for _ in range(2))
        ahead[axis], back[axis] = slice(1, None), slice(None, -1)
        total[tuple(back)] += values[tuple(ahead)]
        total[tuple(ahead)] += values[tuple(back)]
    return total


def chosen(voxel_ids: np.ndarray, sigma: np.ndarray, voxels: int) -> np.ndarray:  # [V] flat indices, [V] -> [T] rows
    """Which places become targets, the most uncertain first: some of the most uncertain, spread evenly over them.

    Equals are taken in the order of a hash of their place, so the choice stays the same from step to step.
    """
    key = voxel_ids.astype(np.uint64) * np.uint64(2654435761) % np.uint64(2**32)  # Knuth's multiplicative hash
    pool = min(POOL, int(np.ceil(POOL_SHARE * voxels)))
    candidates = np.lexsort((key, -sigma))[:pool]
    kept = candidates[np.argsort(key[candidates])][: min(TARGETS, int(np.ceil(TARGET_SHARE * pool)))]
    return kept[np.lexsort((key[kept], -sigma[kept]))]


def visible(volume: VoxelVolume, places: np.ndarray, targets: np.ndarray) -> np.ndarray:  # [P, 3], [T, 3] -> [P, T]
    """Which targets lie at the right distance from each place, with nothing but free voxels on the way."""
    distance = np.linalg.norm(places[:, None] - targets, axis=2)
    seen = (distance > MIN_TARGET_DISTANCE_M) & (distance < MAX_TARGET_DISTANCE_M)
    place, target = np.nonzero(seen)
    share = np.linspace(0.0, 1.0, SAMPLES)[:, None]
    samples = places[place][:, None] * (1.0 - share) + targets[target][:, None] * share  # [pairs, 30, 3]
    free = volume.state_at(samples.reshape(-1, 3)).reshape(-1, SAMPLES) == FREE
    seen[place, target] = free.all(axis=1)
    return seen
