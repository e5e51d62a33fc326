"""Plan motion between views: reachable positions, collision-free paths, and the camera pose of each frame."""

from activestructure_gym.motion.clearance import SAMPLING_DIP, first_blocked_edge
from activestructure_gym.motion.planned_paths import Agent, PlannedPath, least_frames
from activestructure_gym.motion.reachability import DistanceMap, path_lengths
from activestructure_gym.motion.rrt import plan_path
from activestructure_gym.motion.segments import PathSegment, recorded_segments, regular_segments, segments_at
from activestructure_gym.motion.trajectory import (
    MotionConfig,
    arrived_at,
    first_blocked,
    interpolate,
    is_level,
    levelled,
    unrounded_start,
)
from activestructure_gym.motion.voronoi import VoronoiGraph, free_plan, planar_graph, voronoi_graph

__all__ = [
    "SAMPLING_DIP",
    "Agent",
    "DistanceMap",
    "MotionConfig",
    "PathSegment",
    "PlannedPath",
    "VoronoiGraph",
    "arrived_at",
    "first_blocked",
    "first_blocked_edge",
    "free_plan",
    "interpolate",
    "is_level",
    "least_frames",
    "levelled",
    "path_lengths",
    "plan_path",
    "planar_graph",
    "recorded_segments",
    "regular_segments",
    "segments_at",
    "unrounded_start",
    "voronoi_graph",
]
