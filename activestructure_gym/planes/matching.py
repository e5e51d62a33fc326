"""Which node does a new segment belong to, and which two nodes are one surface (Sec. 3.2, dual mode)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from activestructure_gym.planes.detection import PlaneSegment
from activestructure_gym.planes.nodes import PlaneNode


@dataclass(frozen=True)
class MatchingConfig:
    """Gates of the two modes. The paper gives the criteria, not the numbers."""

    coplanar_angle_deg: float = 8.0  # coplanar mode: strict on the plane ...
    coplanar_distance: float = 0.05  # metres, centroid to plane
    lever: float = 0.02  # metres per metre between the centroids: what a short segment's tilt does far away
    coplanar_reach: float = 4.0  # metres between the centroids: ... relaxed on the distance
    touch_reach: float = 0.25  # metres: surfaces that touch belong together at any distance of their centroids
    near_angle_deg: float = 15.0  # near mode: relaxed on the plane ...
    near_distance: float = 0.10  # metres, centroid to plane
    near_reach: float = 0.5  # metres between the centroids: ... strict on the distance
    depth_gap: float = 0.10  # metres between segment and node where both lie on the same rays

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not value >= 0:
                raise ValueError(f"{name} must be 0 or more, got {value}")


def stack_planes(nodes: Sequence[PlaneNode]) -> np.ndarray:  # [N, 7]
    """Normal, offset and centroid of every node, the table that `match_segment` looks through."""
    return np.array([[*node.normal, node.offset, *node.centroid] for node in nodes]).reshape(-1, 7)


def match_segment(
    segment: PlaneSegment,
    camera_position: np.ndarray,
    nodes: Sequence[PlaneNode],
    planes: np.ndarray,  # [N, 7], see `stack_planes`
    config: MatchingConfig,
) -> int | None:
    """Index of the node that the segment continues (closest plane of those that qualify), or None."""
    normals, offsets, centroids = planes[:, :3], planes[:, 3], planes[:, 4:]
    # Normals face the viewer, so the sign counts: the other face of a thin wall is another plane.
    cosine = normals @ segment.normal
    to_node = np.abs(normals @ segment.centroid + offsets)
    to_segment = np.abs(centroids @ segment.normal + segment.offset)
    reach = np.linalg.norm(centroids - segment.centroid, axis=1)
    coplanar = _coplanar(cosine, to_node, to_segment, reach, config)
    near = (cosine > np.cos(np.radians(config.near_angle_deg))) & (to_node < config.near_distance)
    near &= reach < config.near_reach
    gap = np.maximum(to_node, to_segment)
    able = np.flatnonzero(coplanar | near)
    for index in able[np.argsort(gap[able], kind="stable")]:
        node = nodes[index]
        if not near[index] and reach[index] > config.coplanar_reach and not _touches(segment.points, node, config):
            continue
        if not _depth_jumps(segment, camera_position, node, config):
            return int(index)
    return None


def may_be_same(
    node: PlaneNode,
    planes: np.ndarray,  # [N, 7], see `stack_planes`
    config: MatchingConfig,
) -> np.ndarray:  # indices, the node's own among them
    """Nodes that may be the same surface as this one: a look at all planes before `same_surface` looks at each."""
    normals, offsets, centroids = planes[:, :3], planes[:, 3], planes[:, 4:]
    away = np.abs(normals @ node.centroid + offsets)
    back = np.abs(centroids @ node.normal + node.offset)
    near = normals @ node.normal > np.cos(np.radians(config.coplanar_angle_deg)) - 1e-9
    return np.flatnonzero(near & (np.minimum(away, back) < config.coplanar_distance + 1e-9))


def same_surface(first: PlaneNode, second: PlaneNode, config: MatchingConfig) -> bool:
    """Whether two nodes have come to satisfy the coplanar mode."""
    cosine = np.array(first.normal @ second.normal)
    reach = np.array(np.linalg.norm(first.centroid - second.centroid))
    across = np.array(abs(first.normal @ second.centroid + first.offset))
    back = np.array(abs(second.normal @ first.centroid + second.offset))
    if not _coplanar(cosine, np.minimum(across, back), np.maximum(across, back), reach, config):
        return False
    if reach <= config.coplanar_reach:
        return True
    small, large = sorted((first, second), key=lambda node: node.area)
    return _touches(small.surface.points(256), large, config)


def _coplanar(
    cosine: np.ndarray, to_node: np.ndarray, to_segment: np.ndarray, reach: np.ndarray, config: MatchingConfig
) -> np.ndarray:
    far = config.coplanar_distance + config.lever * reach
    return (
        (cosine > np.cos(np.radians(config.coplanar_angle_deg)))
        & (to_node < config.coplanar_distance)
        & (to_segment < far)
    )


def _touches(points: np.ndarray, node: PlaneNode, config: MatchingConfig) -> bool:
    cells = int(np.ceil(config.touch_reach / node.surface.cell))
    return bool(node.surface.contains(points, reach=cells).any())


def _depth_jumps(segment: PlaneSegment, camera_position: np.ndarray, node: PlaneNode, config: MatchingConfig) -> bool:
    """Depth-discontinuity test: along the segment's rays, is the node's plane clearly in front or behind?

    Only rays that meet the node's seen surface count (the overlap); without overlap there is nothing to contradict.
    """
    rays = segment.points - camera_position
    facing = rays @ node.normal
    height = camera_position @ node.normal + node.offset
    with np.errstate(divide="ignore", invalid="ignore"):
        along = -height / facing  # 1 where the node's plane meets the ray at the segment's own depth
    ahead = np.isfinite(along) & (along > 0)
    meets = camera_position + np.where(ahead, along, 1.0)[:, None] * rays
    overlap = ahead & node.surface.contains(meets)
    if not overlap.any():
        return False
    length = np.linalg.norm(rays, axis=1)
    gap = np.abs(along - 1.0) * length
    # Seen at a slant a plane's own noise moves the meeting point along the ray; 0.2 = 78 deg from the normal.
    slant = np.clip(np.abs(facing) / np.maximum(length, 1e-9), 0.2, 1.0)
    return _median((gap * slant)[overlap]) > config.depth_gap


def _median(values: np.ndarray) -> float:
    """`numpy.median` of one or more finite numbers, without its checks, which take longer."""
    low, high = (len(values) - 1) // 2, len(values) // 2
    ordered = np.partition(values, (low, high))
    return float((ordered[low] + ordered[high]) / 2.0)
