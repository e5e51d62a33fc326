"""Predict the path to a candidate view: its frames and its keyframes."""

from __future__ import annotations

import copy
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from activestructure_gym.geometry import rotation_angle
from activestructure_gym.motion.reachability import DistanceMap
from activestructure_gym.motion.rrt import plan_path
from activestructure_gym.motion.trajectory import MotionConfig, interpolate
from activestructure_gym.volume import VoxelVolume


def least_frames(
    pose: np.ndarray,  # [4, 4] world_from_camera, current pose
    goals: np.ndarray,  # [n, 4, 4] world_from_camera
    lengths: np.ndarray,  # [n] path lengths in metres
    motion: MotionConfig,
) -> np.ndarray:  # [n] frames
    """Return the number of frames needed to reach each goal: the larger of steps and turns, at least one."""
    turns = np.degrees(rotation_angle(goals, pose)) / motion.max_turn_deg
    return np.maximum(np.ceil(np.maximum(lengths / motion.max_step_m, turns) - 1e-6), 1)


@dataclass(frozen=True)
class PlannedPath:
    """Hold the path to one view, cut off at the end of the frame budget."""

    frames: int  # number of frames used
    keyframes: np.ndarray  # [K, 4, 4] world_from_camera of the keyframes along the path, including its end


@dataclass(frozen=True)
class Agent:
    """Hold the state of the agent that determines its paths: pose, budget and motion limits."""

    pose: np.ndarray  # [4, 4] world_from_camera
    frames: int  # number of frames used so far
    frame_budget: int
    keyframe_every: int  # frames between two keyframes of a path
    motion: MotionConfig
    distances: DistanceMap  # path lengths from the current position
    rng: np.random.Generator  # generator of the path planner; copied before use, so its state does not change
    stops: np.ndarray = field(default_factory=lambda: np.zeros((0, 4, 4)))  # [D, 4, 4] pose at the end of each decision

    def least_frames(self, goals: np.ndarray) -> np.ndarray:  # [n, 4, 4] -> [n]
        """Return the number of frames needed to reach each goal along the shortest grid path; inf if unreachable."""
        return least_frames(self.pose, goals, self.distances.at(goals[:, :3, 3]), self.motion)

    def along(self, poses: np.ndarray) -> PlannedPath:  # [T, 4, 4]
        """Return the path along ``poses`` (one per frame), cut off at the end of the frame budget."""
        frames = min(len(poses), self.frame_budget - self.frames)
        number = np.arange(1, frames + 1)
        taken = ((self.frames + number) % self.keyframe_every == 0) | (number == frames)
        return PlannedPath(frames, poses[:frames][taken])

    def paths(self, volume: VoxelVolume, goals: Iterable[np.ndarray]) -> list[PlannedPath | None]:  # goals of [4, 4]
        """Return the planned path to every goal through known free space; None if there is none.

        Each goal position is planned once, with a copy of the generator, so the call changes no state. The executed
        path may differ, since it uses the generator itself and avoids obstacles first observed along the path.
        """
        paths: dict[bytes, np.ndarray | None] = {}
        found: list[PlannedPath | None] = []
        for goal in goals:
            place = goal[:3, 3].tobytes()
            if place not in paths:
                paths[place] = plan_path(
                    volume,
                    self.pose[:3, 3],
                    goal[:3, 3],
                    min_clearance=self.motion.min_clearance,
                    rng=copy.deepcopy(self.rng),
                    distances=self.distances,
                )
            path = paths[place]
            found.append(None if path is None else self.along(interpolate(path, self.pose, goal, self.motion)))
        return found
