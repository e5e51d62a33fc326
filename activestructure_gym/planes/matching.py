"""Match segments to planes of the graph (data association, Sec. 3.2), and find planes on the same surface."""

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
    """Configure the thresholds of the coplanar and the near mode. The paper gives the criteria without numbers."""

    coplanar_angle_deg: float = 8.0  # coplanar mode, strict on the plane: largest angle between the normals
    coplanar_distance: float = 0.05  # coplanar mode: metres, largest distance between a centroid and the other plane
    lever: float = 0.02  # added per metre between the centroids: effect of a small segment's tilt over distance
    coplanar_reach: float = 4.0  # coplanar mode, relaxed on the distance: metres between the centroids
    touch_reach: float = 0.25  # metres; surfaces this close match at any distance of their centroids
    near_angle_deg: float = 15.0  # near mode, relaxed on the plane: largest angle between the normals
    near_distance: float = 0.10  # near mode: metres, largest distance between the segment's centroid and the plane
    near_reach: float = 0.5  # near mode, strict on the distance: metres between the centroids
    depth_gap: float = 0.10  # metres, largest distance between segment and plane along rays that meet both

    def __post_init__(self) -> None:
        check_ranges(self, _RANGES)


def stack_planes(nodes: Sequence[PlaneNode]) -> np.ndarray:  # [N, 7]
    """Return normal, offset and centroid of every plane as a table for `match_segment`."""
    return np.array([node.row for node in nodes]).reshape(-1, 7)


def match_segment(
    segment: PlaneSegment,
    camera_position: np.ndarray,  # [3] metres, world
    nodes: Sequence[PlaneNode],
    planes: np.ndarray,  # [N, 7], see `stack_planes`
    config: MatchingConfig,
) -> int | None:
    """Return the index of the closest plane that the segment may belong to, or None."""
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
    """Return the indices of other planes that may be on the same surface, for the id of each plane that has some.

    This tests all pairs of planes at once, before `same_surface` tests single pairs.
    """
    limits = cosine_deg(config.coplanar_angle_deg) - 1e-9, config.coplanar_distance + 1e-9
    pairs: dict[int, list[int]] = {}
    for row, column in kernels.near_pairs(stack_planes(nodes), *limits).tolist():
        pairs.setdefault(nodes[row].id, []).append(column)
    return pairs


def same_surface(first: PlaneNode, second: PlaneNode, config: MatchingConfig) -> bool:
    """Return whether two planes satisfy the coplanar mode."""
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
    """Return whether a plane is clearly in front of or behind the segment along the segment's rays.

    Only rays that meet the seen surface of the plane count; without such rays the result is False.
    """
    surface = node.surface
    grid = surface.frame, surface.low, surface.seen, surface.cell
    gaps = kernels.depth_gaps(segment.points, camera_position, node.normal, node.offset, *grid)
    return len(gaps) > 0 and _median(gaps) > config.depth_gap


def _median(values: np.ndarray) -> float:
    """Return the median of one or more finite numbers, without the slow checks of `numpy.median`."""
    low, high = (len(values) - 1) // 2, len(values) // 2
    ordered = np.partition(values, (low, high))
    return float((ordered[low] + ordered[high]) / 2.0)
