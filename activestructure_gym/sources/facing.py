"""Sources of views that face something: the frontier of what is known, and surface that the map is not sure of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from activestructure_gym.features.uncertain_surface import free_side
from activestructure_gym.features.voxel_errors import voxel_colour_errors
from activestructure_gym.ranges import check_ranges
from activestructure_gym.sources.base import MAX_ROWS, SOURCES, Proposals, Source, SourceContext
from activestructure_gym.sources.places import looking
from activestructure_gym.volume import VoxelVolume
from activestructure_gym.volume.integration import FREE

SIDE = 2  # voxels per side of a region: 0.2 m at the default size, ActiveGS's voxels
_MAX_REGIONS = 1000  # the foremost ones, of which views are sought
_TRIES = 8  # regions of a cube of side `apart_m` of which views are sought, until one has some


@dataclass(frozen=True)
class Facing(Source):
    """Views of regions, the nearest first: from free places 0.3 to 2 m away, within 60 degrees of their normal.

    With ``apart_m`` one region of every cube of that side has views, so that they spread as far as anything is known.
    """

    nearest_m: float = 0.3
    farthest_m: float = 2.0
    per_region: int = 5
    apart_m: float = 0.0
    rows: int = 30

    def __post_init__(self) -> None:
        ranges = {"nearest_m": "[0, 100]", "farthest_m": "(0, 100]", "per_region": "[1, 1000]", "apart_m": "[0, 100]"}
        check_ranges(self, {**ranges, "rows": f"[1, {MAX_ROWS}]"})

    def regions(self, context: SourceContext) -> np.ndarray:  # [X, Y, Z] bool, cells of `SIDE` voxels
        """Which cells are to be looked at."""
        raise NotImplementedError

    def foremost(self, context: SourceContext) -> tuple[np.ndarray, np.ndarray]:  # [M, 3] metres, [M, 3] unit
        """Centres of the regions and where the free space is from there, in the order in which they are faced."""
        volume = context.volume
        free = np.asarray(_coarse(volume.state == FREE).all(axis=-1))
        centres, normals = _facing_free(self.regions(context), free, volume)
        order = np.argsort(np.linalg.norm(centres - context.agent.pose[:3, 3], axis=1), kind="stable")
        return centres[order], normals[order]

    def propose(self, context: SourceContext) -> Proposals:
        """Up to ``per_region`` random places of every region."""
        volume, rng = context.volume, context.rng
        centres, normals = self.foremost(context)
        order = np.arange(len(centres))
        cube = np.zeros(len(centres), dtype=np.int64)
        if self.apart_m:
            corners = np.floor((centres - volume.origin) / self.apart_m)
            cube = np.unique(corners, axis=0, return_inverse=True)[1].ravel()
            order = order[_rank_within(cube[order]) < _TRIES]
        done: set[int] = set()
        places = standing_places(context)
        found: list[np.ndarray] = []
        if len(places):
            tree = cKDTree(places)
            for region in order[:_MAX_REGIONS]:
                if cube[region] in done:
                    continue
                near = np.sort(np.array(tree.query_ball_point(centres[region], self.farthest_m), dtype=int))
                away = places[near] - centres[region]
                far = np.linalg.norm(away, axis=1)
                good = (far >= self.nearest_m) & (away @ normals[region] >= 0.5 * far) & (far > 1e-6)
                chosen = places[near[good]]
                if len(chosen) > self.per_region:
                    chosen = chosen[np.sort(rng.choice(len(chosen), self.per_region, replace=False))]
                chosen = chosen[volume.sight_free(chosen, centres[region])] if len(chosen) else chosen
                if len(chosen):
                    found.append(looking(chosen, centres[region] - chosen))
                    if self.apart_m:
                        done.add(int(cube[region]))
                if sum(map(len, found)) >= self.rows:
                    break
        return Proposals(np.concatenate(found) if found else np.zeros((0, 4, 4)))


@SOURCES.register("frontier_facing")
@dataclass(frozen=True)
class FrontierFacing(Facing):
    """Views that face the frontier: unobserved space that has free space beside it."""

    def regions(self, context: SourceContext) -> np.ndarray:
        """Cells of which half or more is unobserved."""
        return frontier_cells(context.volume)


@SOURCES.register("unsure_facing")
@dataclass(frozen=True)
class UnsureFacing(Facing):
    """Views that face surface whose colour is rendered worse than the mean, the worst first.

    By the mean squared colour error of keyframes in every voxel, as the feature `aiisrfe`.
    """

    def foremost(self, context: SourceContext) -> tuple[np.ndarray, np.ndarray]:
        """The voxels with an error above the mean of those that have one, the largest first."""
        volume, errors = context.volume, voxel_colour_errors(context.mapper, context.volume)
        voxels = np.argwhere(errors > errors[errors > 0].mean() if errors.any() else errors > 0)
        voxels = voxels[np.argsort(-errors[tuple(voxels.T)], kind="stable")]
        normals = free_side(volume, voxels)
        known = normals.any(axis=1)
        return volume.center_of(voxels[known]), normals[known]


def _rank_within(group: np.ndarray) -> np.ndarray:  # [n] -> [n] how many of the same group stand before each
    order = np.argsort(group, kind="stable")
    rank = np.empty(len(group), dtype=np.int64)
    rank[order] = np.arange(len(group)) - np.searchsorted(group[order], group[order])
    return rank


def frontier_cells(volume: VoxelVolume) -> np.ndarray:  # [X, Y, Z] bool, cells of `SIDE` voxels
    """Cells of which half or more is unobserved, without the outermost layer, which lies beyond the workspace."""
    inner = np.zeros(volume.shape, dtype=bool)
    inner[1:-1, 1:-1, 1:-1] = volume.unobserved[1:-1, 1:-1, 1:-1]
    return np.asarray(_coarse(inner).mean(axis=-1) >= 0.5)


def standing_places(context: SourceContext) -> np.ndarray:  # [P, 3] metres
    """Reachable places with a view's clearance at the heights that cameras may have, a cell apart."""
    volume = context.volume
    low, high = (
        context.start[2] + end for end in (min(context.pool.config.heights_m), max(context.pool.config.heights_m))
    )
    reachable = context.agent.distances.reachable
    places = reachable[np.abs(reachable[:, 2] - np.clip(reachable[:, 2], low, high)) <= 0.5 * volume.voxel_size]
    places[:, 2] = np.clip(places[:, 2], low, high)
    places = places[volume.clearance_at(places) >= context.clearance_m]
    _, first = np.unique(volume.voxel_of(places) // SIDE, axis=0, return_index=True)
    return places[np.sort(first)]


def _coarse(grid: np.ndarray) -> np.ndarray:  # [X, Y, Z] -> [X / 2, Y / 2, Z / 2, 8]
    """The voxels of every whole cell."""
    x, y, z = (size // SIDE for size in grid.shape)
    cells = grid[: x * SIDE, : y * SIDE, : z * SIDE].reshape(x, SIDE, y, SIDE, z, SIDE)
    return cells.transpose(0, 2, 4, 1, 3, 5).reshape(x, y, z, SIDE**3)


def _facing_free(
    cells: np.ndarray,  # [X, Y, Z] bool
    free: np.ndarray,  # [X, Y, Z] bool
    volume: VoxelVolume,
) -> tuple[np.ndarray, np.ndarray]:  # [M, 3] metres, [M, 3] unit
    """Centres of those cells that have free ones among their 26 neighbours, and the mean direction to these."""
    at = np.argwhere(cells & ~free)
    padded = np.pad(free, 1)
    towards = np.zeros((len(at), 3))
    for step in np.ndindex(3, 3, 3):
        offset = np.array(step) - 1
        if offset.any():
            beside = padded[tuple((at + step).T)]
            towards += beside[:, None] * (offset / np.linalg.norm(offset))
    length = np.linalg.norm(towards, axis=1)
    kept = length > 1e-6
    centres = volume.origin + (at[kept] + 0.5) * SIDE * volume.voxel_size
    return centres, towards[kept] / length[kept, None]
