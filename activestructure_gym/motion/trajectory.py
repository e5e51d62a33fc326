"""Interpolate paths to one pose per frame, with limited steps and turns, and the camera along the motion."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.errors import InputError
from activestructure_gym.geometry import look_along, rotation_angle, unrounded
from activestructure_gym.motion.clearance import SAMPLING_DIP, first_blocked_edge
from activestructure_gym.ranges import check_ranges
from activestructure_gym.volume import VoxelVolume

_ROLL_TOLERANCE = 1e-5  # largest vertical component of a level camera's right axis
_MIN_DISTANCE_M = 1e-3  # metres; a point closer than this has no view direction

_RANGES = {
    "max_step_m": "[0.001, 100]",
    "max_turn_deg": "[0.1, 180]",
    **dict.fromkeys(("min_clearance", "candidate_clearance", "body_radius", "start_free_radius"), "(0, 100]"),
    "look_ahead_above": "[0, 1e6]",
    "look_ahead_pitch_deg": "[0, 90)",
}


@dataclass(frozen=True)
class MotionConfig:
    """Configure the agent's motion between views."""

    max_step_m: float = 0.1
    """Largest step per frame, metres. [activegamer, code]"""
    max_turn_deg: float = 10.0
    """Largest rotation angle per frame, degrees. [activegamer, code]"""
    min_clearance: float = 0.2
    """Least distance between a path and space not known to be free, metres."""
    candidate_clearance: float = 0.3
    """Least distance between a candidate view and space not known to be free, metres. (own choice)"""
    body_radius: float = 0.3
    """Radius in metres of the sphere around a start pose that must be free."""
    start_free_radius: float = 0.6
    """Radius in metres of the sphere around the start that is marked as free; at most the true clearance there.

    With a smaller radius, one view may not suffice to leave the start (measured: 1 of 3 starts in hotel_room).
    """
    look_ahead_above: float = 1.0
    """On paths longer than this (metres), the camera turns along the motion, as far as this costs no frame."""
    look_ahead_pitch_deg: float = 30.0
    """Largest pitch up or down while looking along the motion, degrees."""

    def __post_init__(self) -> None:
        check_ranges(self, _RANGES)
        if self.candidate_clearance < self.min_clearance:
            raise InputError(
                f"candidate_clearance must be at least min_clearance, got {self.candidate_clearance} "
                f"and {self.min_clearance}"
            )


def interpolate(
    path: np.ndarray,  # [P, 3] metres, from the position of the start pose to that of the goal pose
    start_pose: np.ndarray,  # [4, 4] world_from_camera, without roll
    goal_pose: np.ndarray,  # [4, 4] world_from_camera, without roll
    config: MotionConfig | None = None,
    *,
    look_at: np.ndarray | None = None,  # [3] metres, world: point to look at along the path
) -> np.ndarray:  # [T, 4, 4] world_from_camera, T >= 1: without the start pose, ending at the goal pose
    """Return one pose per frame, each within the step and turn limits; all positions are on the path.

    The number of frames is minimal: the larger of the numbers of steps and turns. If turns take longer, half of the
    waiting is at the start and half at the end; ActiveGAMER waits at the end only. On paths longer than
    ``look_ahead_above``, the camera looks along the motion as far as this number allows; on shorter paths it turns
    evenly.

    With ``look_at``, the camera turns to the point before the first step and keeps it on the optical axis. The agent
    waits if the direction to the point changes faster than the camera can turn. At the goal, the camera turns to the
    goal's direction. This takes more frames.
    """
    config = config or MotionConfig()
    path = np.asarray(path, dtype=np.float64)
    start_pose, goal_pose = np.asarray(start_pose, dtype=np.float64), np.asarray(goal_pose, dtype=np.float64)
    for name, end, pose in (("start", path[0], start_pose), ("end", path[-1], goal_pose)):
        if np.linalg.norm(end - pose[:3, 3]) > 1e-4:
            raise ValueError(f"the path must {name} at the {name} pose {pose[:3, 3]}, got {end}")
    most = np.radians(config.max_turn_deg)
    start_angles, goal_angles = yaw_pitch(start_pose), yaw_pitch(goal_pose)

    track = track_along(path, start_angles, config)
    if look_at is not None:
        positions, angles = _fixating(track.places[:-1], start_angles, goal_angles, look_at, most)
    else:
        places, angles = frames_to(track, start_angles, goal_angles, most)
        positions = track.places[places]
    poses = poses_at(positions, angles[:, 0], angles[:, 1])
    poses[-1] = goal_pose
    return poses


class Track(NamedTuple):
    """Hold the part of the interpolation that all goal poses at the end of a path share."""

    places: np.ndarray  # [M + 2, 3] metres: the start of the path, M steps along it, its end
    ahead: np.ndarray | None  # [M, 2] yaw and pitch along the motion of each step; None on short paths


def track_along(
    path: np.ndarray,  # [P, 3] metres
    start_angles: np.ndarray,  # [2] yaw and pitch at the start
    config: MotionConfig,
) -> Track:
    """Return the steps along a path, at most ``max_step_m`` long, and on long paths the direction of each step.

    All vertices are included, since a cut corner was not checked for collisions.
    """
    places, headings, counts = [path[:1]], list[np.ndarray](), list[int]()
    for first, second in zip(path[:-1], path[1:]):
        length = _length(second - first)
        if length < 1e-9:
            continue
        count = math.ceil(length / config.max_step_m - 1e-9)
        shares = np.arange(1, count + 1)[:, None] / count
        places.append(first * (1 - shares) + second * shares)
        headings.append((second - first) / length)
        counts.append(count)
    ahead = None
    if headings and np.linalg.norm(np.diff(path, axis=0), axis=1).sum() > config.look_ahead_above:
        angles = _look_ahead(headings, start_angles, math.radians(config.look_ahead_pitch_deg))
        ahead = np.repeat(angles, counts, axis=0)
    return Track(np.concatenate([*places, path[-1:]]), ahead)


def frames_to(
    track: Track,
    start_angles: np.ndarray,  # [2] yaw and pitch at the start
    goal_angles: np.ndarray,  # [2] yaw and pitch at the end
    most: float,  # radians per frame
) -> tuple[np.ndarray, np.ndarray]:  # [T] int64 indices into ``places``; [T, 2] yaw and pitch
    """Return the place, yaw and pitch of every frame to a goal, as `interpolate` describes."""
    moves = len(track.places) - 2
    turn = _difference(goal_angles, start_angles)
    turns = math.ceil(_length(turn) / most - 1e-9)
    waiting = max(turns - moves, 0 if moves else 1)
    before, count = waiting // 2, moves + waiting
    number = np.arange(1, count + 1)
    wanted = start_angles + number[:, None] / count * turn
    if track.ahead is not None:
        wanted[before : before + moves] = track.ahead
        wanted[:before] = track.ahead[0]
    return (number - before).clip(0, moves + 1), _limit_turns(wanted, start_angles, goal_angles, most)


def first_blocked(
    volume: VoxelVolume,
    poses: np.ndarray,  # [T, 4, 4] world_from_camera, not yet executed
    min_clearance: float,  # metres
    *,
    start: np.ndarray,  # [4, 4] current pose of the agent
) -> int | None:
    """Return the index of the first pose that is blocked in the updated volume; None if all are free.

    The agent can execute ``poses[:index]`` and plan again from there. Turning in place is never blocked, and a start
    with too little clearance may be left (`first_blocked_edge`). The bound is lowered by the largest decrease of the
    clearance between two samples (0.43 voxels), since frames sample the path at other points. So a path planned in the
    same volume is never blocked.
    """
    if not len(poses):
        return None
    positions = np.vstack([start[None, :3, 3], np.asarray(poses)[:, :3, 3]])
    # Edge n of these positions leads to pose n.
    return first_blocked_edge(volume, positions, min_clearance=min_clearance - SAMPLING_DIP * volume.voxel_size)


def is_level(
    poses: np.ndarray,  # [..., 4, 4] world_from_camera
) -> np.ndarray:  # [...] bool
    """Return which poses have no roll: the image's right axis is horizontal and its up axis does not point down."""
    level: np.ndarray = (np.abs(poses[..., 2, 0]) <= _ROLL_TOLERANCE) & (poses[..., 2, 1] <= _ROLL_TOLERANCE)
    return level


def unrounded_start(
    pose: np.ndarray,  # [4, 4] world_from_camera, nearly rigid
) -> np.ndarray:  # [4, 4]
    """Return the pose with an orthonormal rotation; a level pose (without roll) remains level.

    The nearest rotation of a level pose with rounded entries may have more roll than motion allows.
    """
    nearest = unrounded(pose)
    if is_level(nearest) or not is_level(pose):
        return nearest
    yaw, pitch = yaw_pitch(pose)
    return poses_at(pose[None, :3, 3], np.array([yaw]), np.array([pitch]))[0]


def levelled(
    pose: np.ndarray,  # [4, 4] world_from_camera
) -> np.ndarray:  # [4, 4]
    """Return the pose without roll: the same position and optical axis, the image's right axis horizontal."""
    return pose if is_level(pose) else look_along(pose[:3, 3], pose[:3, 2])


def arrived_at(
    pose: np.ndarray,  # [4, 4] world_from_camera, the agent's
    goal: np.ndarray,  # [4, 4] world_from_camera
    config: MotionConfig,
) -> bool:
    """Return whether the agent is within one frame's step and turn of a goal."""
    metres = float(np.linalg.norm(pose[:3, 3] - goal[:3, 3]))
    degrees = float(np.degrees(rotation_angle(pose, goal)))
    return metres <= config.max_step_m and degrees <= config.max_turn_deg


def yaw_pitch(
    pose: np.ndarray,  # [..., 4, 4] world_from_camera, without roll
) -> np.ndarray:  # [..., 2] radians: yaw around world z (0 = +x), pitch (positive = up)
    """Return yaw and pitch of the optical axis. For a vertical axis the yaw follows from the right axis.

    Raises ValueError for a pose with roll. `geometry.look_along` creates poses without roll, and motion adds none.
    """
    level = is_level(pose)
    if not level.all():
        wrong = pose[~level][0] if pose.ndim > 2 else pose
        raise ValueError(f"expected a pose without roll (image right level, image up not down), got {wrong[:3, :3]}")
    right, forward = pose[..., :3, 0], pose[..., :3, 2]
    pitch = np.arctan2(forward[..., 2], np.hypot(forward[..., 0], forward[..., 1]))
    return np.stack([np.arctan2(right[..., 0], -right[..., 1]), pitch], axis=-1)


def poses_at(
    positions: np.ndarray,  # [T, 3] metres, world
    yaw: np.ndarray,  # [T] radians
    pitch: np.ndarray,  # [T] radians
) -> np.ndarray:  # [T, 4, 4] world_from_camera
    """Return the poses with the given positions, yaws and pitches, the inverse of `yaw_pitch`.

    Unlike `look_along` it is exact for vertical view directions too.
    """
    zero, one = np.zeros_like(yaw), np.ones_like(yaw)
    ahead = np.stack([np.cos(yaw), np.sin(yaw), zero], axis=-1)
    up = np.stack([zero, zero, one], axis=-1)
    poses = np.tile(np.eye(4), (len(positions), 1, 1))
    poses[:, :3, 0] = np.stack([np.sin(yaw), -np.cos(yaw), zero], axis=-1)
    poses[:, :3, 1] = np.sin(pitch)[:, None] * ahead - np.cos(pitch)[:, None] * up
    poses[:, :3, 2] = np.cos(pitch)[:, None] * ahead + np.sin(pitch)[:, None] * up
    poses[:, :3, 3] = positions
    return poses


def _fixating(
    places: np.ndarray,  # [M, 3] metres: the start, then one position per step
    start: np.ndarray,  # [2] yaw and pitch at the start
    goal: np.ndarray,  # [2] yaw and pitch at the goal
    point: np.ndarray,  # [3] metres, world
    most: float,  # radians per frame
) -> tuple[np.ndarray, np.ndarray]:  # positions [T, 3], yaw and pitch [T, 2]
    """Return positions and angles that keep ``point`` in view.

    The agent waits where the camera cannot turn fast enough.
    """
    towards = np.asarray(point, dtype=np.float64) - places
    level = np.hypot(towards[:, 0], towards[:, 1])
    wanted = np.stack([np.arctan2(towards[:, 1], towards[:, 0]), np.arctan2(towards[:, 2], level)], axis=-1)
    for n in np.nonzero(np.linalg.norm(towards, axis=1) < _MIN_DISTANCE_M)[0].tolist():  # too close to have a direction
        wanted[n] = wanted[n - 1] if n else start
    wanted[level < _MIN_DISTANCE_M, 0] = start[0]  # every yaw is valid directly above or below the point
    moves, angles, here = list[np.ndarray](), list[np.ndarray](), start

    def turn(aim: np.ndarray, before: int, after: int) -> None:
        """Turn to ``aim`` at the position with index ``before``; the last turn is made with the step to ``after``."""
        nonlocal here
        waiting = int(np.ceil(_length(_difference(aim.copy(), here)) / most - 1e-9))
        for left in range(max(waiting, after - before), 0, -1):
            here = here + _at_most(_difference(aim.copy(), here), most)
            moves.append(places[after if left == 1 else before])
            angles.append(here)

    turn(wanted[0], 0, 0)
    for n in range(1, len(places)):
        turn(wanted[n], n - 1, n)
    turn(goal, len(places) - 1, len(places) - 1)
    if not moves:
        return places[-1:], goal[None]
    return np.array(moves), np.array(angles)


def _look_ahead(headings: list[np.ndarray], start_angles: np.ndarray, most_pitch: float) -> np.ndarray:  # [E, 2]
    """Return yaw and pitch along each of E headings [3], unit vectors of motion.

    Vertical motion keeps the previous yaw, which is at first that of ``start_angles``. The pitch is limited to
    ``most_pitch`` radians.
    """
    angles = np.empty((len(headings), 2))
    yaw = start_angles[0]
    for n, heading in enumerate(headings):
        level = np.hypot(heading[0], heading[1])
        if level > 0.1:
            yaw = np.arctan2(heading[1], heading[0])
        angles[n] = yaw, min(max(np.arctan2(heading[2], level), -most_pitch), most_pitch)
    return angles


def _difference(to: np.ndarray, from_: np.ndarray) -> np.ndarray:
    """Return ``to - from_`` in (yaw, pitch), with the yaw wrapped to [-pi, pi).

    The length of this vector bounds the rotation angle. Yaw and pitch turn around perpendicular axes, so cos(angle / 2)
    = cos(dyaw / 2) cos(dpitch / 2) >= cos(length / 2).
    """
    difference = to - from_
    difference[..., 0] = (difference[..., 0] + np.pi) % (2 * np.pi) - np.pi
    return difference


def _length(turn: np.ndarray) -> float:
    """Return the Euclidean length of a vector [2], in a third of the time of `numpy.linalg.norm`."""
    return math.sqrt(turn.dot(turn))


def _at_most(turn: np.ndarray, most: float) -> np.ndarray:
    length = _length(turn)
    return turn if length <= most else turn * (most / length)


@kernel
def _limit_turns(
    wanted: np.ndarray,  # [T, 2] yaw and pitch
    start: np.ndarray,  # [2] yaw and pitch
    goal: np.ndarray,  # [2] yaw and pitch
    most: float,  # radians per frame; T frames must suffice from start to goal
) -> np.ndarray:  # [T, 2] yaw and pitch; the last row is the goal
    """Return yaw and pitch of every frame: close to ``wanted``, within the turn limit, and ending at ``goal``.

    In every frame the camera turns towards its wanted angles by at most ``most``. The turn is bent towards the goal
    only as far as needed to reach it in the remaining frames.
    """
    angles = np.empty_like(wanted)
    yaw, pitch = start[0], start[1]
    for n in range(len(wanted)):
        turn, nod = _short_way(wanted[n, 0] - yaw), wanted[n, 1] - pitch
        home_turn, home_nod = _short_way(goal[0] - yaw), goal[1] - pitch
        budget = most * (len(wanted) - 1 - n)  # angle that can be turned after this frame
        length = np.sqrt(turn * turn + nod * nod)
        if length > most:
            turn, nod = turn * (most / length), nod * (most / length)
        if not _within(home_turn - turn, home_nod - nod, budget):
            # Find the smallest bend by bisection: the reachable set is convex and contains the direct turn to the goal.
            straight_turn, straight_nod = home_turn, home_nod
            length = np.sqrt(home_turn * home_turn + home_nod * home_nod)
            if length > most:
                straight_turn, straight_nod = home_turn * (most / length), home_nod * (most / length)
            bend_turn, bend_nod = straight_turn - turn, straight_nod - nod
            low, high = 0.0, 1.0
            for _ in range(40):
                middle = 0.5 * (low + high)
                if _within(home_turn - (turn + middle * bend_turn), home_nod - (nod + middle * bend_nod), budget):
                    high = middle
                else:
                    low = middle
            turn, nod = turn + high * bend_turn, nod + high * bend_nod
        yaw, pitch = yaw + turn, pitch + nod
        angles[n, 0], angles[n, 1] = yaw, pitch
    angles[-1, 0], angles[-1, 1] = goal[0], goal[1]
    return angles


@kernel
def _short_way(turn: float) -> float:
    """Return a yaw difference wrapped to [-pi, pi)."""
    return (turn + np.pi) % (2.0 * np.pi) - np.pi


@kernel
def _within(turn: float, nod: float, most: float) -> bool:
    return np.sqrt(turn * turn + nod * nod) <= most
