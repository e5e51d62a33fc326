"""Propose views that face the frontier of unobserved space, or badly rendered surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from activestructure_gym.features.uncertain_surface import free_side
from activestructure_gym.features.voxel_errors import voxel_colour_errors
from activestructure_gym.ranges import check_ranges
from activestructure_gym.sources.base import MAX_ROWS, SOURCES, Proposals, Source, SourceContext
from activestructure_gym.sources.places import looking
from activestructure_gym.volume import VoxelVolume

SIDE = 2  # voxels per side of a cell: 0.2 m at the default voxel size, the voxel size of ActiveGS
_MAX_REGIONS = 1000  # maximum number of regions tested per decision, in order of priority
_TRIES = 8  # maximum number of regions tested per cube of side `apart_m`, until one has views


@dataclass(frozen=True)
class Facing(Source):
    """Propose views of regions, nearest first, from free positions within 60 degrees of the region's normal.

    A region is a cell of 2 x 2 x 2 voxels or a voxel, chosen by the subclass. The distance of the positions is between
    ``nearest_m`` and ``farthest_m``. With ``apart_m``, only one region per cube of that side (metres) has views, so
    that they spread over the known space.
    """

    nearest_m: float = 0.3
    farthest_m: float = 2.0
    per_region: int = 5
    apart_m: float = 0.0
    rows: int = 30

    def __post_init__(self) -> None:
        ranges = {"nearest_m": "[0, 100]", "farthest_m": "(0, 100]", "per_region": "[1, 1000]", "apart_m": "[0, 100]"}
        check_ranges(self, {**ranges, "rows": f"[1, {MAX_ROWS}]"})

    def regions(self, context: SourceContext) -> tuple[np.ndarray, np.ndarray]:  # [M, 3] int64, [M, 3]
        """Return the cells of `SIDE` voxels that the views should face, and their normals.

        Where the normal is 0, the mean direction to the empty ones of the 26 neighbours replaces it.
        """
        raise NotImplementedError

    def foremost(self, context: SourceContext) -> tuple[np.ndarray, np.ndarray]:  # [M, 3] metres, [M, 3] unit
        """Return centres and normals (towards free space) of the regions in order of priority: nearest first."""
        volume = context.volume
        cells, normals = self.regions(context)
        normals = np.where(normals.any(axis=1, keepdims=True), normals, _towards(cells, empty_cells(volume)))
        length = np.linalg.norm(normals, axis=1)
        kept = length > 1e-6
        centres = volume.origin + (cells[kept] + 0.5) * SIDE * volume.voxel_size
        normals = normals[kept] / length[kept, None]
        order = np.argsort(np.linalg.norm(centres - context.agent.pose[:3, 3], axis=1), kind="stable")
        return centres[order], normals[order]

    def propose(self, context: SourceContext) -> Proposals:
        """Return views of the regions from up to ``per_region`` random positions each.

        The cameras look at the centre of the region, and no occupied voxel is between.
        """
        volume, rng = context.volume, context.rng
        centres, normals = self.foremost(context)
        order = np.arange(len(centres))
        cube = np.zeros(len(centres), dtype=np.int64)
        if self.apart_m:
            corners = np.floor((centres - volume.origin) / self.apart_m)
            cube = np.unique(corners, axis=0, return_inverse=True)[1].ravel()
            order = order[_rank_within(cube[order]) < _TRIES]
        done: set[int] = set()
        places = camera_positions(context)
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
                chosen = chosen[volume.line_of_sight_free(chosen, centres[region])] if len(chosen) else chosen
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
    """Propose views that face the frontier: empty space next to unobserved space."""

    def regions(self, context: SourceContext) -> tuple[np.ndarray, np.ndarray]:
        """Return the frontier cells, without normals."""
        cells = np.argwhere(frontier_cells(context.volume))
        return cells, np.zeros(cells.shape)


@SOURCES.register("unsure_facing")
@dataclass(frozen=True)
class UnsureFacing(Facing):
    """Propose views that face surface with a colour error above the mean, largest error first.

    The error is the mean squared colour error of keyframes per voxel, as in the feature `aiisrfe`.
    """

    def foremost(self, context: SourceContext) -> tuple[np.ndarray, np.ndarray]:
        """Return centres and normals of voxels with an error above the mean positive error, the largest error first."""
        volume, errors = context.volume, voxel_colour_errors(context.mapper, context.volume)
        voxels = np.argwhere(errors > errors[errors > 0].mean() if errors.any() else errors > 0)
        voxels = voxels[np.argsort(-errors[tuple(voxels.T)], kind="stable")]
        normals = free_side(volume, voxels)
        known = normals.any(axis=1)
        return volume.center_of(voxels[known]), normals[known]


def _rank_within(group: np.ndarray) -> np.ndarray:  # [n] -> [n] number of previous entries of the same group
    order = np.argsort(group, kind="stable")
    rank = np.empty(len(group), dtype=np.int64)
    rank[order] = np.arange(len(group)) - np.searchsorted(group[order], group[order])
    return rank


def empty_cells(volume: VoxelVolume) -> np.ndarray:  # [X, Y, Z] bool, cells of `SIDE` voxels
    """Return which cells have been observed and hold no occupied voxel.

    A single keyframe is enough, as for a free voxel in [active_gs, code]. The state FREE needs more evidence.
    """
    return ~np.asarray(_coarse(volume.occupied | volume.unobserved).any(axis=-1))


def frontier_cells(volume: VoxelVolume) -> np.ndarray:  # [X, Y, Z] bool, cells of `SIDE` voxels
    """Return which empty cells have a face in common with an unobserved cell ([active_gs, code]).

    A cell is unobserved if at least half of it is and no voxel of it is occupied: a wall is no frontier, although the
    voxels behind its surface are unobserved. The outermost layer of voxels is outside the workspace and does not count
    as unobserved.
    """
    inner = np.zeros(volume.shape, dtype=bool)
    inner[1:-1, 1:-1, 1:-1] = volume.unobserved[1:-1, 1:-1, 1:-1]
    unobserved = (_coarse(inner).mean(axis=-1) >= 0.5) & ~_coarse(volume.occupied).any(axis=-1)
    return np.asarray(empty_cells(volume) & ndimage.binary_dilation(unobserved))


def camera_positions(context: SourceContext) -> np.ndarray:  # [P, 3] metres
    """Return reachable positions for cameras, one per cell of 2 x 2 x 2 voxels.

    They have the clearance of views, and their heights are between the lowest and the highest of the shared pool.
    """
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
    """Return the voxel grid as cells of 2 x 2 x 2 voxels, which are the last axis; incomplete cells are cut off."""
    x, y, z = (size // SIDE for size in grid.shape)
    cells = grid[: x * SIDE, : y * SIDE, : z * SIDE].reshape(x, SIDE, y, SIDE, z, SIDE)
    return cells.transpose(0, 2, 4, 1, 3, 5).reshape(x, y, z, SIDE**3)


def _towards(
    cells: np.ndarray,  # [M, 3] int64
    empty: np.ndarray,  # [X, Y, Z] bool
) -> np.ndarray:  # [M, 3]
    """Return the sum of the unit directions from each cell to those of its 26 neighbours in ``empty``."""
    padded = np.pad(empty, 1)
    towards = np.zeros((len(cells), 3))
    for step in np.ndindex(3, 3, 3):
        offset = np.array(step) - 1
        if offset.any():
            neighbour = padded[tuple((cells + step).T)]
            towards += neighbour[:, None] * (offset / np.linalg.norm(offset))
    return towards
