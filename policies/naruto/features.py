"""Compute NARUTO's goal score and look-at list ([naruto]), with the limit of its learned uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from activestructure_gym.features.context import FeatureContext
from activestructure_gym.features.registry import FEATURES
from activestructure_gym.features.voxel_errors import squared_depth_error, voxel_sums
from activestructure_gym.geometry import invert_rigid, transform_points
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.mapping import KeyframeMapper
from activestructure_gym.volume import FREE, VoxelVolume

INITIAL = float(np.log1p(np.exp(3.0)) + 0.01)  # 3.06 m^2, sigma of a place that no ray has measured
FLOOR = 0.01  # m^2, minimum sigma
POOL = 4000  # maximum number of voxels from which targets are chosen, the most uncertain ones
TARGETS = 300  # maximum number of targets
POOL_SHARE = POOL / (81 * 51 * 32)  # maximum size of the pool as a share of all voxels, as in room0: 3.0 %
TARGET_SHARE = 0.075  # maximum number of targets as a share of the pool
MIN_TARGET_DISTANCE_M, MAX_TARGET_DISTANCE_M = 0.5, 2.0  # metres between a goal and a target that it sees
SAMPLES = 30  # number of points between goal and target that must be free
LOOKS = 2  # keyframes within 2 m that see an unmeasured place before its sigma is `FLOOR`
LISTED = 10  # maximum number of targets in the look-at list
DRAW = np.uint64(0x9E3779B9)  # turns the keys that break ties at the pool's edge into independent keys for the draw


@dataclass(frozen=True)
class Targets:
    """Hold the T most uncertain places of a step, and which of K positions see them."""

    positions: np.ndarray  # [T, 3] metres, world, the most uncertain first
    sigma: np.ndarray  # [T] m^2, uncertainty
    seen: np.ndarray  # [K, T] bool, whether the target is seen from each position


@FEATURES.register("naruto", unit="sum of uncertainties", low=0.0)
def naruto(context: FeatureContext) -> np.ndarray:  # [K] >= 0
    """Compute S(g) = sum over targets t of sigma(t) [0.5 m < |g - t| < 2 m] [all 30 samples of g..t are free].

    sigma is the uncertainty of a target in m^2. A bracket is 1 if its condition holds, else 0. g is the candidate's
    position; its view direction has no effect. Source: [naruto, code].
    """
    targets = context.once(find_targets)
    return targets.seen @ targets.sigma


@FEATURES.register("naruto_look", columns=[f"{rank}_{axis}" for rank in range(LISTED) for axis in "xyz"], unit="m")
def naruto_look(context: FeatureContext) -> np.ndarray:  # [K, 30] metres, world
    """Compute the look-at list of a goal at the candidate's position: x, y, z (m, world) of 10 targets.

    The list contains the 10 most uncertain targets seen from this position. Missing targets are replaced by the
    position itself.
    """
    targets = context.once(find_targets)
    listed = np.repeat(context.world_from_camera[:, None, :3, 3], LISTED, axis=1)
    rank = np.cumsum(targets.seen, axis=1) - 1  # targets are sorted by uncertainty
    row, target = np.nonzero(targets.seen & (rank < LISTED))
    listed[row, rank[row, target]] = targets.positions[target]
    return listed.reshape(len(listed), 3 * LISTED)


def find_targets(context: FeatureContext) -> Targets:
    """Return the targets and their visibility from every candidate; call it by ``context.once(find_targets)``."""
    return targets_from(context.mapper, context.volume, context.world_from_camera[:, :3, 3])


def targets_from(mapper: KeyframeMapper, volume: VoxelVolume, positions: np.ndarray) -> Targets:  # [K, 3] metres
    """Return up to 300 of the most uncertain places, and their visibility from each of K positions (metres, world)."""
    voxels, sigma = learned_uncertainty(mapper, volume)
    voxel_ids = np.asarray(np.ravel_multi_index(tuple(voxels.T), volume.shape))
    kept = chosen(voxel_ids, sigma, volume.state.size, len(mapper.keyframes))
    targets = volume.center_of(voxels[kept])
    places, place_of = np.unique(positions, axis=0, return_inverse=True)
    return Targets(targets, sigma[kept], visible(volume, places, targets)[place_of.ravel()])


def learned_uncertainty(mapper: KeyframeMapper, volume: VoxelVolume) -> tuple[np.ndarray, np.ndarray]:
    """Return the result of `uncertainty`; sigma is `FLOOR` at unmeasured places that `LOOKS` keyframes looked at."""
    voxels, sigma, measured = uncertainty(volume, *voxel_sums(mapper, volume, squared_depth_error))
    unmeasured = np.flatnonzero(~measured)
    looks = looked_at(mapper.keyframes, volume, volume.center_of(voxels[unmeasured]))
    sigma[unmeasured[looks >= LOOKS]] = FLOOR
    return voxels, sigma


def uncertainty(
    volume: VoxelVolume,
    errors: np.ndarray,  # [X, Y, Z] m^2, sum of the squared depth errors of the pixels in each voxel
    pixels: np.ndarray,  # [X, Y, Z] number of these pixels
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # [V, 3] voxels near the surface, sigma [V], measured [V] bool
    """Return the V free voxels next to a voxel that is not free, the uncertainty sigma (m^2), and which are measured.

    sigma is the mean squared depth error of all pixels, at least `FLOOR`, where the nearby surface is measured. This
    surface is the voxel, its non-free neighbours and the non-free neighbours of those. The second ring is needed
    because a voxel that the surface only touches can stay unknown. The surface is measured if it has a pixel or an
    occupied voxel. Otherwise sigma is `INITIAL` = softplus(3) + 0.01.

    This approximates [naruto, code], which learns sigma = softplus(u) + 0.01 with the loss E / (2 U) + 1/2 log U. U is
    sum w^2 sigma over a ray. E is the mean of (D - D_measured)^2 over all rays of the batch, since the code broadcasts
    the errors over all rays. If all weight of a ray is at one place, the learned sigma converges to E. It stays at
    `INITIAL` where no ray has measured.
    """
    free = volume.state == FREE
    voxels = np.argwhere(free & (_neighbour_sum((~free).astype(np.float64)) > 0))
    at = tuple(voxels.T)

    def around(values: np.ndarray) -> np.ndarray:  # [X, Y, Z] -> [V]
        behind = np.where(free, 0.0, values)
        behind = np.where(free, 0.0, behind + _neighbour_sum(behind))
        return np.asarray(values[at] + _neighbour_sum(behind)[at])

    mean = float(errors.sum() / max(pixels.sum(), 1.0))
    measured = around(pixels + volume.occupied) > 0
    return voxels, np.where(measured, max(mean, FLOOR), INITIAL), measured


def looked_at(keyframes: Sequence[Frame], volume: VoxelVolume, places: np.ndarray) -> np.ndarray:  # [P, 3] -> [P] int64
    """Return the number of keyframes that see each place from within 2 m, counted up to `LOOKS`.

    This rule is ours. In [naruto, code] each keyframe changes u in two steps of rate 1, so two keyframes lower it from
    3 to about -1, a sigma of 0.32. A place that rays only cross changes less. Without the rule, the agent would return
    to a place that no ray measures for ever.
    """
    counts = np.zeros(len(places), np.int64)
    for frame in keyframes:
        left = np.flatnonzero(counts < LOOKS)
        if not len(left):
            break
        pose = frame.world_from_camera
        points = transform_points(invert_rigid(pose), places[left])
        near = left[frame.camera.in_image(points) & (np.linalg.norm(points, axis=1) < MAX_TARGET_DISTANCE_M)]
        if len(near):
            counts[near] += volume.line_of_sight_free(pose[:3, 3], places[near])
    return counts


def _neighbour_sum(values: np.ndarray) -> np.ndarray:  # [X, Y, Z] -> sum over the 6 neighbours
    total = np.zeros_like(values)
    for axis in range(3):
        ahead, back = ([slice(None)] * 3 for _ in range(2))
        ahead[axis], back[axis] = slice(1, None), slice(None, -1)
        total[tuple(back)] += values[tuple(ahead)]
        total[tuple(ahead)] += values[tuple(back)]
    return total


def chosen(
    voxel_ids: np.ndarray,  # [V] flat indices
    sigma: np.ndarray,  # [V]
    voxels: int,  # number of all voxels of the grid
    keyframes: int,
) -> np.ndarray:  # [T] rows
    """Return the rows of the voxels that become targets, the most uncertain first.

    They are a random part of the most uncertain voxels, which changes with the number of ``keyframes``. Hashes of the
    voxel's index and of this number replace random numbers, so that all features of a decision have the same targets.
    The ties at the edge of the pool and the draw from it have independent hashes.
    """
    key = _scrambled(voxel_ids.astype(np.uint64) ^ _scrambled(np.array([keyframes], np.uint64)))
    pool = min(POOL, int(np.ceil(POOL_SHARE * voxels)))
    candidates = np.lexsort((key, -sigma))[:pool]
    drawn = np.argsort(_scrambled(key[candidates] ^ DRAW))[: min(TARGETS, int(np.ceil(TARGET_SHARE * pool)))]
    kept = candidates[drawn]
    return kept[np.lexsort((key[kept], -sigma[kept]))]


def _scrambled(numbers: np.ndarray) -> np.ndarray:  # [N] uint64 below 2^32, both
    """Return a hash of each number: two rounds of Knuth's multiplicative hash, with the high bits folded down."""
    for _ in range(2):
        numbers = numbers * np.uint64(2654435761) % np.uint64(2**32)
        numbers ^= numbers >> np.uint64(16)
    return numbers


def visible(volume: VoxelVolume, places: np.ndarray, targets: np.ndarray) -> np.ndarray:  # [P, 3], [T, 3] -> [P, T]
    """Return which targets each place sees: at a distance of 0.5 to 2 m, with 30 free samples in between."""
    distance = np.linalg.norm(places[:, None] - targets, axis=2)
    seen = (distance > MIN_TARGET_DISTANCE_M) & (distance < MAX_TARGET_DISTANCE_M)
    place, target = np.nonzero(seen)
    for share in np.linspace(0.0, 1.0, SAMPLES):
        free = volume.state_at(places[place] * (1.0 - share) + targets[target] * share) == FREE
        seen[place[~free], target[~free]] = False
        place, target = place[free], target[free]
    return seen
