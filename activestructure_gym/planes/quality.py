"""Assess planes by eight failure modes, a scalar quality, and deficiency centres: targets for new views (Sec. 3.3).

The paper names the modes; the formulas are this project's. The modes are independent: a hole inside a plane lowers only
mode viii, a missing corner only mode i, an edge with unknown space beyond it only mode v.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from activestructure_gym.errors import InputError, short_repr
from activestructure_gym.planes import quality_kernels as kernels
from activestructure_gym.planes.detection import cosine_deg
from activestructure_gym.planes.nodes import PlaneNode
from activestructure_gym.planes.sparseness import MapPoints, SparsePatches, sparse_patches
from activestructure_gym.planes.surface import SurfaceGrid, disc, stack_grids
from activestructure_gym.planes.surface_kernels import UNKNOWN
from activestructure_gym.planes.vectors import length
from activestructure_gym.ranges import check_ranges

QUALITY_MODES = (
    "coverage",  # i
    "density",  # ii
    "fit",  # iii
    "observations",  # iv
    "boundary",  # v
    "normals",  # vi
    "stability",  # vii
    "interior",  # viii
)
SPACE_UNKNOWN, SPACE_FREE, SPACE_OCCUPIED = 0, 1, 2
SpaceState = Callable[[np.ndarray], np.ndarray]  # world points [K, 3] -> uint8 [K]: one of the three states
_RANGES = {
    "density_target": "(0, 1e9]",
    **dict.fromkeys(("fit_scale", "shift_scale", "area_scale"), "(0, 1000]"),
    "observations_target": "[1, 1000000]",
    **dict.fromkeys(("boundary_reach", "space_step", "coarse_size"), "[0, 1000]"),
    "normal_angle_deg": "(0, 180]",
    "closing_radius": "[0, 1000]",
    "hole_tile": "[1, 100000]",
    **dict.fromkeys(("min_hole_cells", "min_sparse_cells"), "[0, 1000000]"),
    "min_hole_radius": "[0, 100000]",
    **dict.fromkeys(("weights_structural", "weights_object"), "[0, 1]"),
}


@dataclass(frozen=True)
class QualityConfig:
    """Configure the scale at which the score of each mode becomes low, and the weights of Eq. 7."""

    density_target: float = 400.0  # mode ii: points per m^2 for the full score
    fit_scale: float = 0.01  # mode iii: rms distance of the pixels to the plane at which the score is 1/e, metres
    observations_target: int = 5  # mode iv: number of keyframes for the full score
    boundary_reach: float = 0.10  # mode v: metres between an edge and another plane that closes it
    space_step: float = 0.15  # mode v: metres beyond an edge at which space is tested; more than one voxel of 10 cm
    normal_angle_deg: float = 15.0  # mode vi: mean deviation of the normals at which the score is 0
    shift_scale: float = 0.05  # mode vii: shift of the centroid at which the score is 1/e, metres
    area_scale: float = 0.10  # mode vii: relative change of the area at which the score is 1/e
    closing_radius: int = 3  # mode viii: radius of the morphological closing, cells
    hole_tile: int = 10  # mode viii: side of a tile, cells; each tile of a hole has one deficiency centre (0.5 m)
    min_hole_cells: int = 4  # mode viii: smaller holes lower the score but have no deficiency centre
    min_sparse_cells: int = 20  # mode viii: fewest coarsely mapped cells of a tile with a deficiency centre
    coarse_size: float = 1.0  # mode viii: size in cells of the largest fine Gaussian (plain surface: sigma 0.81)
    min_hole_radius: float = 1.5  # mode viii: cells; narrower holes have no deficiency centre
    # Whether cells count as holes although no view can fill them: cells with free space behind (a window, a doorway) or
    # covered by an object (a picture, a cupboard's back). True is Eq. 6 exactly.
    count_explained_holes: bool = True
    # Weights of Eq. 7 for structural planes, modes i to viii; largest for i, viii and vi.
    weights_structural: tuple[float, ...] = (0.25, 0.05, 0.10, 0.05, 0.05, 0.15, 0.10, 0.25)
    # Weights of Eq. 7 for other planes, modes i to viii; largest for ii, v and iv.
    weights_object: tuple[float, ...] = (0.10, 0.25, 0.10, 0.15, 0.20, 0.05, 0.05, 0.10)

    def __post_init__(self) -> None:
        check_ranges(self, _RANGES)
        for name in ("weights_structural", "weights_object"):
            weights = getattr(self, name)
            if len(weights) != 8 or abs(sum(weights) - 1.0) > 1e-9:
                raise InputError(f"{name} must be eight weights of 0 or more that sum to 1, got {short_repr(weights)}")


@dataclass(frozen=True)
class Quality:
    """Hold the quality of all planes; 1 is good."""

    modes: np.ndarray  # [N, 8] score of each mode in [0, 1], columns as in QUALITY_MODES
    scores: np.ndarray  # [N] weighted mean q of the modes, in [0, 1]


@dataclass(frozen=True)
class Deficiencies:
    """Hold the deficiency centres of all planes: targets for the next views."""

    centres: np.ndarray  # [D, 3] metres, world: inside a hole or on a coarsely mapped patch
    normals: np.ndarray  # [D, 3] unit normal of the plane, towards the side from which it is observed
    areas: np.ndarray  # [D] m^2 of the hole or patch that the centre represents
    planes: np.ndarray  # [D] int64 index of the plane
    sizes: np.ndarray  # [D] metres, mean size of the Gaussians on a coarsely mapped patch; inf in a hole
    explained: np.ndarray  # [D] bool: an image observed something else there, so no view can fill the hole

    def __len__(self) -> int:
        return len(self.centres)


@dataclass
class Interior:
    """Hold the terms of Eq. 6 for the grid of one plane, and the outer edge of its cells."""

    mask: np.ndarray  # [R, C] uint8: I, the seen cells after closing, with enclosed holes filled
    missing_share: float  # g = |I \\ O| / |I|, with the seen cells O
    cells: int  # number of cells of I
    hull_cells: int  # number of cells with their centre in the convex hull of I
    missing: np.ndarray  # [R', C'] bool: I \\ O in the bounding rectangle of the seen cells
    corner: np.ndarray  # [2] row and column in the grid at which ``missing`` begins
    sides: int  # number of boundary sides: sides of cells of I towards other cells
    unexplained: np.ndarray  # [M, 3] int64 row, column, direction of the sides beyond which no image observed anything
    density: float  # mean over O of the number of pixels per cell / its target, at most 1 per cell; 0 without cells
    config: QualityConfig  # with which the terms were computed
    modes: np.ndarray | None = None  # [8] scores of the plane, except that of the boundary; set at the first use


def interior(surface: SurfaceGrid, config: QualityConfig) -> Interior:
    """Return the closed and filled mask of a plane, and its missing cells (Eq. 6); cached until the grid changes."""
    known = surface.memo.get("interior")
    if isinstance(known, Interior) and known.config is config:
        return known
    seen, beside = surface.seen, surface.beside
    # Closing and filling stay inside the bounding rectangle of the seen cells.
    mask, total, box, hull_cells, sides, unexplained, ratios = kernels.survey(
        seen, surface.hits, beside, disc(config.closing_radius), config.density_target * surface.cell**2
    )
    top, left, height, width = box.tolist()
    part = (slice(top, top + height), slice(left, left + width))
    missing = mask[part] > seen[part]
    if not config.count_explained_holes:
        missing &= beside[part] == UNKNOWN
    share = float(np.count_nonzero(missing) / total) if total else 1.0
    # The density is limited per cell, so that dense cells do not compensate for sparse ones.
    density = float(np.add.reduce(ratios)) / len(ratios) if len(ratios) else 0.0
    result = Interior(mask, share, total, hull_cells, missing, box[:2], sides, unexplained, density, config)
    surface.memo["interior"] = result
    return result


def holes(surface: SurfaceGrid, config: QualityConfig) -> tuple[np.ndarray, np.ndarray]:  # [D, 2], [D]
    """Return one cell per tile of every hole of a plane, and the number of missing cells that each represents."""
    known = surface.memo.get(("holes", config))
    if not isinstance(known, tuple):
        inside = interior(surface, config)
        cells, sizes = _hole_tiles(inside.missing, config)
        known = surface.memo["holes", config] = cells + inside.corner, sizes
    return known


def _hole_tiles(missing: np.ndarray, config: QualityConfig) -> tuple[np.ndarray, np.ndarray]:
    """Return one cell per tile of every hole in the mask ``missing`` [R, C], and the number of cells of the tile.

    It is the cell of the hole nearest to the mean of the tile's cells.
    """
    if np.count_nonzero(missing) < config.min_hole_cells:
        return np.zeros((0, 2), np.int64), np.zeros(0, np.int64)
    # Only the bounding rectangle is processed: most grids are large and most holes small.
    cells = np.ascontiguousarray(missing).view(np.uint8)
    left, top, width, height = cv2.boundingRect(cells)
    cells = np.ascontiguousarray(cells[top : top + height, left : left + width])
    padded = cv2.copyMakeBorder(cells, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
    count, labels = cv2.connectedComponents(padded, connectivity=8)
    depth = cv2.distanceTransform(padded, cv2.DIST_L2, 3)
    cells, sizes = kernels.tile_holes(
        np.asarray(labels), np.asarray(depth), count, config.min_hole_radius, config.hole_tile, config.min_hole_cells
    )
    return cells + np.array([top - 1, left - 1]), sizes


def boundary_closure(
    nodes: Sequence[PlaneNode], config: QualityConfig, space_state: SpaceState | None = None
) -> np.ndarray:  # [N] in [0, 1]
    """Return the fraction of each plane's outer edge beyond which something is known (mode v).

    Something is known if an image of the plane observed it next to the plane, if another plane is within reach, and,
    with ``space_state``, if the space is occupied or free. The edges of holes inside the plane belong to mode viii.
    """
    if not nodes:
        return np.zeros(0)
    surfaces = [node.surface for node in nodes]
    grids = stack_grids(surfaces)
    edges = [interior(surface, config) for surface in surfaces]
    sides = np.array([edge.sides for edge in edges], np.float64)
    ends = np.cumsum([len(edge.unexplained) for edge in edges])
    near = np.concatenate([surface.near.ravel() for surface in surfaces])
    probes, owner = kernels.open_sides(
        np.concatenate([edge.unexplained for edge in edges]), ends, near, grids, surfaces[0].cell,
        config.boundary_reach, config.space_step,
    )  # fmt: skip
    unclosed = np.bincount(owner, minlength=len(nodes)).astype(np.float64)
    if space_state is not None and len(probes):
        known = np.asarray(space_state(probes)) != SPACE_UNKNOWN
        unclosed -= np.bincount(owner[known], minlength=len(nodes))
    return np.where(sides > 0, 1.0 - unclosed / np.maximum(sides, 1.0), 0.0)


def normal_consistency(normals: Sequence[np.ndarray], max_angle_deg: float) -> float:
    """Return the mean alignment of normals with their mean: 1 if equal, 0 if ``max_angle_deg`` off (mode vi)."""
    if not len(normals):
        return 0.0
    stack = np.array(normals)
    mean = np.add.reduce(stack, axis=0) / len(stack)  # the mean, in a third of the time of `numpy.mean`
    size = length(mean)
    if not size > 1e-9:
        return 0.0
    alignment = float(np.add.reduce(np.abs(stack @ (mean / size)))) / len(stack)
    floor = cosine_deg(max_angle_deg)
    return min(max((alignment - floor) / (1.0 - floor), 0.0), 1.0)


def _own_modes(node: PlaneNode, config: QualityConfig) -> np.ndarray:  # [8]
    """Return the scores [8] of all modes except the boundary mode, cached until a keyframe observes the plane."""
    inside = interior(node.surface, config)
    if inside.modes is None:
        # A plane observed once has infinite change, so its score is 0.
        change = node.shift / config.shift_scale + node.area_change / config.area_scale
        fit, stability = np.exp(np.array([-node.rms / config.fit_scale, -change])).tolist()
        inside.modes = np.array([
            min(1.0, inside.cells / max(inside.hull_cells, 1)),
            inside.density,
            fit,
            min(1.0, node.observations / config.observations_target),
            0.0,
            normal_consistency([*node.normals.values()], config.normal_angle_deg),
            stability,
            1.0 - inside.missing_share,  # Eq. 6
        ])  # fmt: skip
    return inside.modes


def assess_quality(
    nodes: Sequence[PlaneNode],
    structural: np.ndarray,  # [N] bool: weights of structural planes apply
    config: QualityConfig | None = None,
    *,
    space_state: SpaceState | None = None,
) -> Quality:
    """Return the scores of all modes and their weighted mean (Eq. 7) for planes of any size."""
    config = config or QualityConfig()
    modes = np.array([_own_modes(node, config) for node in nodes]).reshape(-1, 8)
    if len(nodes):
        modes[:, 4] = boundary_closure(nodes, config, space_state)
    weights = np.where(np.asarray(structural, dtype=bool)[:, None], config.weights_structural, config.weights_object)
    return Quality(modes=modes, scores=(weights * modes).sum(axis=1))  # Eq. 7


def coarse_patches(nodes: Sequence[PlaneNode], config: QualityConfig, points: MapPoints) -> SparsePatches:
    """Return the seen patches of all planes on which the map's Gaussians are coarser than a cell of the plane.

    The function reads nothing that `assess_quality` changes, so both may run in parallel.
    """
    largest = config.coarse_size * nodes[0].surface.cell if nodes else 0.0
    return sparse_patches(nodes, points, tile=config.hole_tile, least_cells=config.min_sparse_cells, largest=largest)


def find_deficiencies(
    nodes: Sequence[PlaneNode], config: QualityConfig | None = None, *, coarse: SparsePatches | None = None
) -> Deficiencies:
    """Return the deficiency centres C_def of all planes: the holes, sorted by plane, then the patches ``coarse``."""
    config = config or QualityConfig()
    centres, normals, areas, owner = [np.zeros((0, 3))], [np.zeros((0, 3))], [np.zeros(0)], [np.zeros(0, np.int64)]
    explained = [np.zeros(0, bool)]
    for k, node in enumerate(nodes):
        cells, cells_each = holes(node.surface, config)
        if len(cells):
            centres.append(node.surface.cell_centres(cells[:, 0], cells[:, 1]))
            normals.append(np.repeat(node.normal[None], len(cells), axis=0))
            areas.append(cells_each * node.surface.cell**2)
            owner.append(np.full(len(cells), k, np.int64))
            explained.append(node.surface.beside[cells[:, 0], cells[:, 1]] != UNKNOWN)
    sizes = [np.full(sum(map(len, areas)), np.inf)]
    if coarse is not None and nodes:
        centres.append(coarse.centres)
        normals.append(np.stack([node.normal for node in nodes])[coarse.planes])
        areas.append(coarse.areas)
        owner.append(coarse.planes)
        sizes.append(coarse.sizes)
        explained.append(np.zeros(len(coarse.sizes), bool))
    return Deficiencies(
        np.concatenate(centres), np.concatenate(normals), np.concatenate(areas), np.concatenate(owner),
        np.concatenate(sizes), np.concatenate(explained),
    )  # fmt: skip
