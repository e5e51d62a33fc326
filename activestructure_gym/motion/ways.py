"""The way to a view before it is chosen: how many frames it costs and where its keyframes would be taken."""

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
    pose: np.ndarray,  # [4, 4] world_from_camera
    goals: np.ndarray,  # [n, 4, 4]
    lengths: np.ndarray,  # [n] metres of the ways there
    motion: MotionConfig,
) -> np.ndarray:  # [n]
    """Frames it takes to reach each goal: its steps or its turns, whichever are more, and at least one."""
    turns = np.degrees(rotation_angle(goals, pose)) / motion.max_turn_deg
    return np.maximum(np.ceil(np.maximum(lengths / motion.max_step_m, turns) - 1e-6), 1)


@dataclass(frozen=True)
class Way:
    """The way to one view, as far as the budget reaches."""

    frames: int  # paid
    keyframes: np.ndarray  # [K, 4, 4] world_from_camera of those taken on it, its end among them


@dataclass(frozen=True)
class Agent:
    """Where the agent stands, and how it gets to a view: everything that decides a way besides the volume."""

    pose: np.ndarray  # [4, 4] world_from_camera
    frames: int  # paid so far
    frame_budget: int
    keyframe_every: int  # frames
    motion: MotionConfig
    distances: DistanceMap  # from where it stands
    rng: np.random.Generator  # of the planner of paths; copied before use, so that nothing is drawn from it
    stops: np.ndarray = field(default_factory=lambda: np.zeros((0, 4, 4)))  # [D, 4, 4] where each decision has ended

    def least_frames(self, goals: np.ndarray) -> np.ndarray:  # [n, 4, 4] -> [n]
        """Frames it takes to reach each goal by the way on the grid; inf where there is none."""
        return least_frames(self.pose, goals, self.distances.at(goals[:, :3, 3]), self.motion)

    def along(self, poses: np.ndarray) -> Way:  # [T, 4, 4]
        """The frames of ``poses`` that an episode would pay, and the keyframes it would take of them."""
        frames = min(len(poses), self.frame_budget - self.frames)
        number = np.arange(1, frames + 1)
        taken = ((self.frames + number) % self.keyframe_every == 0) | (number == frames)
        return Way(frames, poses[:frames][taken])

    def ways(self, volume: VoxelVolume, goals: Iterable[np.ndarray]) -> list[Way | None]:  # goals of [4, 4]
        """The way to every goal through what is known to be free; None where there is none.

        A path to a place is planned once, so nothing changes by asking; the episode may find another one. That what is
        seen on the way may block it is not foreseen.
        """
        paths: dict[bytes, np.ndarray | None] = {}
        found: list[Way | None] = []
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
