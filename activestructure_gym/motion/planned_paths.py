"""Predict the path to a candidate view: its frames and its keyframes."""

from __future__ import annotations

import copy
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from activestructure_gym.geometry import rotation_angle
from activestructure_gym.motion.reachability import DistanceMap
from activestructure_gym.motion.rrt import plan_path
from activestructure_gym.motion.trajectory import MotionConfig, Track, frames_to, poses_at, track_along, yaw_pitch
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

    def _taken(self, count: int) -> tuple[int, np.ndarray]:
        """Return the number of frames used by a path of ``count`` poses, and the indices of its keyframes."""
        frames = min(count, self.frame_budget - self.frames)
        taken = np.arange(-(self.frames + 1) % self.keyframe_every, frames, self.keyframe_every)
        if frames > 0 and not (len(taken) and taken[-1] == frames - 1):
            taken = np.append(taken, frames - 1)
        return frames, taken

    def paths(self, volume: VoxelVolume, goals: Iterable[np.ndarray]) -> list[PlannedPath | None]:  # goals of [4, 4]
        """Return the planned path to every goal through known free space; None if there is none.

        Each goal position is planned once, with a copy of the generator, so the call changes no state. The executed
        path may differ, since it uses the generator itself and avoids obstacles first observed along the path.
        The poses are those of `interpolate`, computed for the keyframes of all paths together.
        """
        wanted = np.array(list(goals), dtype=np.float64).reshape(-1, 4, 4)
        here, most = np.asarray(self.pose, dtype=np.float64), np.radians(self.motion.max_turn_deg)
        tracks = self._tracks(volume, here, wanted[:, :3, 3])
        found: list[PlannedPath | None] = [None] * len(tracks)
        reached = [(n, track) for n, track in enumerate(tracks) if track is not None]
        if not reached:
            return found
        start_angles, goal_angles = yaw_pitch(here), yaw_pitch(wanted[[n for n, _ in reached]])
        used, positions, angles, ends = list[int](), list[np.ndarray](), list[np.ndarray](), list[bool]()
        for (_, track), goal in zip(reached, goal_angles):
            places, turned = frames_to(track, start_angles, goal, most)
            frames, taken = self._taken(len(places))
            used.append(frames)
            ends.append(frames == len(places))
            positions.append(track.places[places[taken]])
            angles.append(turned[taken])
        poses = poses_at(np.concatenate(positions), *np.concatenate(angles).T)
        split = np.split(poses, np.cumsum([len(part) for part in positions])[:-1])
        for (n, _), frames, at_end, keyframes in zip(reached, used, ends, split):
            if at_end:
                keyframes[-1] = wanted[n]
            found[n] = PlannedPath(frames, keyframes)
        return found

    def _tracks(self, volume: VoxelVolume, start: np.ndarray, places: np.ndarray) -> list[Track | None]:
        """Return the track to every goal position [n, 3]; None if there is none."""
        start_angles = yaw_pitch(start)
        rng = copy.deepcopy(self.rng)
        state, tracks = rng.bit_generator.state, dict[bytes, Track | None]()
        for place in places:
            if (key := place.tobytes()) in tracks:
                continue
            rng.bit_generator.state = state
            path = plan_path(
                volume,
                start[:3, 3],
                place,
                min_clearance=self.motion.min_clearance,
                rng=rng,
                distances=self.distances,
            )
            tracks[key] = None if path is None else track_along(path, start_angles, self.motion)
        return [tracks[place.tobytes()] for place in places]
