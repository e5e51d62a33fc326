"""Match segments to nodes, and find nodes of the same surface (data association, dual mode, Sec. 3.2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from activestructure_gym.planes import matching_kernels as kernels
from activestructure_gym.planes.detection import PlaneSegment, cosine_deg
from activestructure_gym.planes.nodes import PlaneNode
from activestructure_gym.planes.vectors import distance
from activestructure_gym.ranges import check_ranges

_RANGES = {
    **dict.fromkeys(("coplanar_angle_deg", "near_angle_deg"), "[0, 90]"),
    **dict.fromkeys(("coplanar_distance", "coplanar_reach", "touch_reach", "near_distance", "near_reach", "depth_gap"),
                    "[0, 1000]"),
    "lever": "[0, 100]",
}  # fmt: skip


@dataclass(frozen=True)
class MatchingConfig:
    """Configure the gates of both modes. The paper gives the criteria, not the numbers."""

    coplanar_angle_deg: float = 8.0  # coplanar mode: strict on the plane ...
    coplanar_distance: float = 0.05  # metres, centroid to plane
    lever: float = 0.02  # metres per metre between the centroids: effect of a short segment's tilt over distance
    coplanar_reach: float = 4.0  # metres between the centroids: ... relaxed on the distance
    touch_reach: float = 0.25  # metres: surfaces this close match, whatever the distance of their centroids
    near_angle_deg: float = 15.0  # near mode: relaxed on the plane ...
    near_distance: float = 0.10  # metres, centroid to plane
    near_reach: float = 0.5  # metres between the centroids: ... strict on the distance
    depth_gap: float = 0.10  # metres between segment and node along common rays

    def __post_init__(self) -> None:
        check_ranges(self, _RANGES)


def stack_planes(nodes: Sequence[PlaneNode]) -> np.ndarray:  # [N, 7]
    """Return normal, offset and centroid of every node as a table for `match_segment`."""
    return np.array([node.row for node in nodes]).reshape(-1, 7)


def match_segment(
    segment: PlaneSegment,
    camera_position: np.ndarray,
    nodes: Sequence[PlaneNode],
    planes: np.ndarray,  # [N, 7], see `stack_planes`
    config: MatchingConfig,
) -> int | None:
    """Return the index of the node that the segment continues (closest qualifying plane), or None."""
    limits = (
        cosine_deg(config.coplanar_angle_deg), config.coplanar_distance, config.lever, config.coplanar_reach,
        cosine_deg(config.near_angle_deg), config.near_distance, config.near_reach,
    )  # fmt: skip
    able = kernels.qualifying(planes, segment.normal, segment.offset, segment.centroid, limits)
    for _, index, far in sorted(able.tolist()):
        node = nodes[int(index)]
        if far and not _touches(segment.points, node, config):
            continue
        if not _depth_jumps(segment, camera_position, node, config):
            return int(index)
    return None


def may_be_same(nodes: Sequence[PlaneNode], config: MatchingConfig) -> dict[int, list[int]]:
    """Return by node id the indices of other nodes that may be the same surface, if any.

    This tests all pairs of planes at once, before `same_surface` tests single pairs.
    """
    planes = stack_planes(nodes)
    normals, offsets, centroids = planes[:, :3], planes[:, 3], planes[:, 4:]
    away = np.abs(centroids @ normals.T + offsets)  # [N, N] distance of the row's centroid to the column's plane
    near = normals @ normals.T > cosine_deg(config.coplanar_angle_deg) - 1e-9
    near &= np.minimum(away, away.T) < config.coplanar_distance + 1e-9
    np.fill_diagonal(near, False)
    pairs: dict[int, list[int]] = {}
    for row, column in zip(*(side.tolist() for side in np.nonzero(near))):
        pairs.setdefault(nodes[row].id, []).append(column)
    return pairs


def same_surface(first: PlaneNode, second: PlaneNode, config: MatchingConfig) -> bool:
    """Return whether two nodes satisfy the coplanar mode."""
    cosine = float(first.normal @ second.normal)
    reach = distance(first.centroid, second.centroid)
    across = abs(float(first.normal @ second.centroid + first.offset))
    back = abs(float(second.normal @ first.centroid + second.offset))
    if not _coplanar(cosine, min(across, back), max(across, back), reach, config):
        return False
    if reach <= config.coplanar_reach:
        return True
    small, large = sorted((first, second), key=lambda node: node.area)
    return _touches(small.surface.points(256), large, config)


def _coplanar(cosine: float, to_node: float, to_segment: float, reach: float, config: MatchingConfig) -> bool:
    return (
        cosine > cosine_deg(config.coplanar_angle_deg)
        and to_node < config.coplanar_distance
        and to_segment < config.coplanar_distance + config.lever * reach
    )


def _touches(points: np.ndarray, node: PlaneNode, config: MatchingConfig) -> bool:
    cells = int(np.ceil(config.touch_reach / node.surface.cell))
    return bool(node.surface.contains(points, reach=cells).any())


def _depth_jumps(segment: PlaneSegment, camera_position: np.ndarray, node: PlaneNode, config: MatchingConfig) -> bool:
    """Return whether the node's plane is clearly in front of or behind the segment along the segment's rays.

    Only rays that meet the node's seen surface (the overlap) count; without overlap the result is False.
    """
    surface = node.surface
    grid = surface.frame, surface.low, surface.seen, surface.cell
    gaps = kernels.depth_gaps(segment.points, camera_position, node.normal, node.offset, *grid)
    return len(gaps) > 0 and _median(gaps) > config.depth_gap


def _median(values: np.ndarray) -> float:
    """Return `numpy.median` of one or more finite numbers, without its slower checks."""
    low, high = (len(values) - 1) // 2, len(values) // 2
    ordered = np.partition(values, (low, high))
    return float((ordered[low] + ordered[high]) / 2.0)
