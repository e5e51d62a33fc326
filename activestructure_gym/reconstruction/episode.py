"""Run one episode of active reconstruction, from the first frame to the last, without Gymnasium.

Each decision runs: world -> frame -> map, volume, planes -> candidate views -> features. The caller then chooses a
view, and the agent moves there (`Reconstruction.move_to`). Every frame costs 1 of the budget. Every
``keyframe_every``-th frame and the last frame of a path are keyframes: captured, integrated and mapped.
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from activestructure_gym.compiling.thread_team import default_threads
from activestructure_gym.errors import InputError
from activestructure_gym.features import evaluate_features
from activestructure_gym.ground_truth import GroundTruth
from activestructure_gym.mapping.gaussian_map import LOG_SCALE, MEAN
from activestructure_gym.motion import (
    DistanceMap,
    PathSegment,
    arrived_at,
    first_blocked,
    interpolate,
    levelled,
    path_lengths,
    plan_path,
)
from activestructure_gym.planes import MapPoints
from activestructure_gym.reconstruction.offering import Offering
from activestructure_gym.reconstruction.parts import (
    make_given_pool,
    make_mapper,
    make_planes,
    make_pool,
    make_volume,
    tracked,
    tracks,
)
from activestructure_gym.reconstruction.state import EpisodeState
from activestructure_gym.sensors import Frame
from activestructure_gym.views import GivenViews
from activestructure_gym.worlds import (
    CaptureFailed,
    SceneWorld,
    World,
    captured,
    checked_bounds,
    checked_start,
    frame_from,
)

_MAX_FAILURES = 3  # captures in a row that may fail; the next failure ends the episode with its error


@dataclass(frozen=True)
class StepResult:
    """Record one step: frames, metres and keyframes on the path to the chosen view."""

    reached: bool  # False: unreachable, blocked on the path, or the budget ended
    frames: int  # frames of the budget used
    metres: float
    keyframes: tuple[Frame, ...]  # frames that were integrated


class Reconstruction(EpisodeState):
    """Hold the state of one episode. `start` begins it, `move_to` executes a decision; attributes are read-only.

    Parameters
    ----------
    config
        Everything that determines an episode except scene, seed and policy.

    Examples
    --------
    >>> from activestructure_gym import configure, ground_truth_of, load_scene
    >>> episode = Reconstruction(configure("fast", {"frame_budget": 30}))
    >>> frame = episode.start(ground_truth_of(load_scene("box")), seed=0)
    >>> result = episode.move_to(0)  # move to the first candidate
    >>> result.reached, episode.frames > 1
    (True, True)
    """

    def start(self, world: World | GroundTruth, seed: int, start_pose: np.ndarray | None = None) -> Frame:
        """Begin an episode and return its first keyframe.

        Parameters
        ----------
        world
            A world, or the `GroundTruth` of a scene, which the configured sensor then captures.
        seed
            Determines every random choice.
        start_pose
            ``world_from_camera`` [4, 4], only with a ground truth. Default: one of the scene's start poses, drawn from
            the seed. A `World` states its start itself.

        Raises
        ------
        InputError
            If the pose is outside the scene or in collision, or the world's camera is not the configured one.
        """
        config = self.config
        # One random stream per consumer: a policy's choices cannot change the noise, nor the noise the planned paths.
        choice, noise, mapping, planning, pool, sources = np.random.SeedSequence(seed).spawn(6)
        if isinstance(world, GroundTruth):
            if start_pose is None:
                poses = world.free_space.start_poses
                start_pose = poses[np.random.default_rng(choice).integers(len(poses))]
            self._set_scene(SceneWorld(
                world, config.sensor, np.random.default_rng(noise),
                start_pose=start_pose, body_radius=config.motion.body_radius,
            ))  # fmt: skip
        else:
            if start_pose is not None:
                raise InputError("a world has its own start pose: leave out start_pose")
            if world.camera != config.sensor.camera:
                raise InputError(
                    f"the configured sensor is {config.sensor.camera}, and the world's camera is {world.camera}; set "
                    "it with activestructure_gym.worlds.with_camera(config, camera)"
                )
            self.world, self._exact = world, bool(getattr(world, "exact_motion", False))
            if (reset := getattr(world, "reset", None)) is not None:
                reset(seed)
        bounds = self.bounds = checked_bounds(self.world.bounds)
        start = checked_start(self.world.start, bounds)
        start_pose = start.pose if self._exact else levelled(start.pose)

        self.mapper = make_mapper(config, bounds, np.random.default_rng(mapping))
        self.volume, self.planes = make_volume(config, bounds), make_planes(config)
        pool_seed = int(pool.generate_state(1)[0])
        if (views := getattr(self.world, "views", None)) is None:
            self.pool = make_pool(config, bounds, start_pose[:3, 3], pool_seed)
        else:
            self.pool = make_given_pool(config, views, self.volume, bounds, pool_seed, self._sources)
        self._planning_rng = np.random.default_rng(planning)
        self._sources_seed = int(sources.generate_state(1)[0])
        self._offered = {0}  # stages offered since the last frame was used
        self._empty = set[int]()  # offered stages that had no candidates
        self._failures = 0  # captures in a row that have failed
        self._begin_at(start.pose)
        self.pose = start_pose

        # The start pose is collision-free, so a sphere within the start's clearance is marked as free.
        self.volume.mark_free_sphere(start_pose[:3, 3], min(config.motion.start_free_radius, start.free_radius))
        frame = self._keyframe(start.pose[None])
        self.frames = 1
        self._refresh()
        return frame

    def _set_scene(self, world: SceneWorld) -> None:
        self.world, self._exact, self.scene, self.sensor = world, True, world.scene, world.sensor

    def move_to(self, index: int) -> StepResult:
        """Execute candidate ``index`` of the current table and map on the path to it.

        Most rows are views to move to. Others optimise in place, look at a point on the path, end the episode, or
        switch to another candidate stage, which costs no frame. An index beyond the table, and a view without a path,
        cost one frame and leave the agent in place; the unreachable view is removed from the pool. A path that newly
        observed obstacles block ends before the obstacle. A path ends too if a keyframe was taken elsewhere than asked
        for, by more than one frame's step or turn; planning continues from there. The view stays in the pool if the
        camera has come nearer to it by more than half a step. A keyframe that the world cannot take (`CaptureFailed`)
        ends the path at the keyframe before it, and costs one frame. The agent is then assumed to be at that keyframe.
        The fourth failure in a row is raised.
        """
        self.decisions += 1
        frames_before, metres_before = self.frames, self.metres
        reached, keyframes = False, list[Frame]()
        table, self.chosen = self.candidates, index
        if not 0 <= index < len(table):
            self._let_pass()
        elif table.ask[index] >= 0:
            self.stage = int(table.ask[index])
            self._offered.add(self.stage)
            self._note_segment()
            self._offer()
            return StepResult(True, 0, 0.0, ())
        elif table.ends[index]:
            reached = self.finished = True
        elif table.stay[index]:
            wanted = int(table.stay[index]) * self.config.keyframe_every
            reached = self._stay(wanted) == wanted
            self.stops.append(self.pose)
        else:
            point = table.look_at[index]
            poses = self._plan(table.world_from_camera[index], None if np.isnan(point).any() else point)
            if poses is None:
                self.pool.drop(int(self.candidates.ids[index]))
                self._let_pass()
            else:
                goal, before = poses[-1, :3, 3], self.pose[:3, 3]
                reached, elsewhere, keyframes = self._walk(poses, revisits=bool(table.revisit[index]))
                nearer = math.dist(before, goal) - math.dist(self.pose[:3, 3], goal)
                on_its_way = elsewhere and nearer > 0.5 * self.config.motion.max_step_m
                if not (reached or on_its_way or self.exhausted):
                    # Blocked by an obstacle that is now in the volume, or by one that it lacks: the same view is not
                    # tried again.
                    self.pool.drop(int(table.ids[index]))
            self.pool.mark_visited(self.pose)
            self.stops.append(self.pose)
        if self.frames > frames_before:
            self._offered, self._empty = {self.stage}, set()
        self._note_segment(stays=0 <= index < len(table) and bool(table.stay[index]))
        self._refresh()
        return StepResult(reached, self.frames - frames_before, self.metres - metres_before, tuple(keyframes))

    def _let_pass(self) -> None:
        """Use one frame of the budget, if one is left (the first frame may have been the last)."""
        self.frames = min(self.frames + 1, self.config.frame_budget)

    def follow(self, segment: PathSegment) -> StepResult:
        """Execute given poses in place of a decision, within the budget, and map at the segment's keyframes.

        Neither collisions nor the distance between poses are checked. The last frame of the budget is a keyframe.
        """
        self.decisions += 1
        frames_before, metres_before, keyframes = self.frames, self.metres, list[Frame]()
        if segment.stays:
            self._stay(segment.stays)
        since = 0  # first pose after the last keyframe
        for number, (pose, refine_factor) in enumerate(zip(segment.poses, segment.refine_factors), start=1):
            if self.exhausted:
                break
            self._step_to(pose)
            if refine_factor or self.exhausted:
                keyframes.append(self._keyframe(segment.poses[since:number], refine_factor or 1))
                since = number
        self.frames = min(self.frames + segment.lost, self.frame_budget)
        self.stops.append(self.pose)
        self._note_segment(stays=bool(segment.stays))
        self._refresh()
        paid = self.frames - frames_before
        reached = paid == len(segment.poses) + segment.lost + segment.stays
        return StepResult(reached, paid, self.metres - metres_before, tuple(keyframes))

    def _note_segment(self, *, stays: bool = False) -> None:
        self.legs.append((len(self.trajectory), self.frames, int(stays)))

    def _plan(self, goal: np.ndarray, look_at: np.ndarray | None) -> np.ndarray | None:  # [T, 4, 4]
        motion = self.config.motion
        with self._timed("planning"):
            path = plan_path(
                self.volume,
                self.pose[:3, 3],
                goal[:3, 3],
                min_clearance=motion.min_clearance,
                rng=self._planning_rng,
                distances=self.distances,
            )
            return None if path is None else interpolate(path, self.pose, goal, motion, look_at=look_at)

    def _stay(self, wanted: int) -> int:
        """Optimise over all keyframes in place for up to ``wanted`` frames; return the number of frames used.

        Each frame runs ``iterations / keyframe_every`` optimiser steps, as on a path.
        """
        frames = min(wanted, self.config.frame_budget - self.frames)
        self.trajectory += [self.pose] * frames
        self.frames += frames
        with self._timed("mapping"):
            self.mapper.refine(round(self.config.mapper.iterations * frames / self.config.keyframe_every))
            self.mapper.keyframe_psnr()  # so that a policy sees what staying brings
        return frames

    def _step_to(self, pose: np.ndarray) -> None:
        pose = np.array(pose, dtype=np.float64)  # a copy: the caller may reuse its array
        step = pose[:3, 3] - self.pose[:3, 3]
        self.metres += math.sqrt(step @ step)
        self.pose = pose
        self.trajectory.append(pose)
        self.frames += 1

    def _walk(self, poses: np.ndarray, *, revisits: bool) -> tuple[bool, bool, list[Frame]]:
        """Execute frames until the goal, the end of the budget, an obstacle, or a keyframe elsewhere or not taken.

        Return whether the goal was reached, whether a keyframe elsewhere ended the path, and the keyframes.

        If ``revisits``, the frame at the goal is mapped with ``revisit_rounds`` times the iterations.
        """
        keyframes: list[Frame] = []
        index, end = 0, len(poses)  # poses[:end] is free in the current volume
        since, kept = 0, (self.frames, self.metres, self.pose)  # first pose after the last keyframe; state there
        while index < end and not self.exhausted:
            self._step_to(poses[index])
            index += 1
            due = index == end or self.exhausted or self.frames % self.config.keyframe_every == 0
            if due and (view := self._capturable(poses[index - 1])) is not None:
                refine_factor = self.config.revisit_rounds if revisits and index == len(poses) else 1
                path = np.concatenate([poses[since : index - 1], view[None]])
                try:
                    keyframes.append(self._keyframe(path, refine_factor))
                except CaptureFailed:
                    self._failures += 1
                    if self._failures > _MAX_FAILURES and not getattr(self.world, "stopped", False):
                        raise
                    del self.trajectory[len(self.trajectory) - (index - since) :]
                    self.frames, self.metres, self.pose = kept
                    self._let_pass()
                    return False, False, keyframes
                since, kept = index, (self.frames, self.metres, self.pose)
                if not self._exact and not arrived_at(self.pose, poses[index - 1], self.config.motion):
                    return False, True, keyframes
                with self._timed("planning"):
                    blocked = first_blocked(
                        self.volume, poses[index:end], self.config.motion.min_clearance, start=self.pose
                    )
                end = end if blocked is None else index + blocked
        return index == len(poses), False, keyframes

    def _capturable(self, pose: np.ndarray) -> np.ndarray | None:  # [4, 4]
        """Return where to take a keyframe that is due at ``pose``; None if the world has no view near it."""
        if not isinstance(self.pool, GivenViews):
            return pose
        motion = self.config.motion
        return self.pool.at(pose, metres=motion.max_step_m, degrees=motion.max_turn_deg)

    def _keyframe(self, path: np.ndarray, refine_factor: int = 1) -> Frame:
        """Travel along ``path`` [P, 4, 4], capture a keyframe at its end, integrate it and return it as integrated."""
        with self._timed("sensor"):
            if (travel := getattr(self.world, "travel", None)) is not None:
                travel(path.copy())
            frame = captured(self.world, path[-1])
        self._failures = 0
        sensor = self.config.sensor
        if not self._exact:
            frame = frame_from(frame.rgb, frame.depth, frame.world_from_camera, sensor.camera, sensor.max_range)
        if tracks(self.config):
            with self._timed("tracking"):
                frame = tracked(frame, self.mapper.keyframes, self.trajectory[0], self.config)
        if not self._exact:
            self._correct_pose(frame.world_from_camera)
        with self._timed("volume"):
            self.volume.integrate(frame, sensor_range=sensor.max_range, dropouts=sensor.edge_dropout)
        iterations = refine_factor * self.config.mapper.iterations
        if self.config.mapper.enabled and self.config.planes.enabled and default_threads() > 1:
            # Map and planes are independent. Mapping runs mostly in kernels, which release the GIL.
            with ThreadPoolExecutor(1) as beside:
                planes = beside.submit(self.planes.integrate, frame)
                with self._timed("mapping"):
                    self.mapper.observe(frame, iterations=iterations)
                with self._timed("planes"):  # the time that mapping did not overlap
                    planes.result()
        else:
            with self._timed("mapping"):
                self.mapper.observe(frame, iterations=iterations)
            with self._timed("planes"):
                self.planes.integrate(frame)
        self.keyframe_indices.append(len(self.trajectory) - 1)
        self.refine_factors.append(refine_factor)
        return frame

    def _correct_pose(self, taken: np.ndarray) -> None:
        """Replace the last pose of the trajectory by the pose [4, 4] where the keyframe was really taken."""
        if len(self.trajectory) > 1:
            before, wanted = self.trajectory[-2][:3, 3], self.trajectory[-1][:3, 3]
            walked = np.linalg.norm(taken[:3, 3] - before) - np.linalg.norm(wanted - before)
            self.metres = max(0.0, self.metres + float(walked))
        self.trajectory[-1] = taken
        self.pose = levelled(taken)  # paths turn by yaw and pitch only
        if isinstance(self.pool, GivenViews):
            self.pool.mark_visited(self.pose)  # views on the path too

    def _refresh(self) -> None:
        """Build the candidates of the next decision and compute their features."""
        config = self.config
        with self._timed("planning"):
            self.distances: DistanceMap = path_lengths(
                self.volume, self.pose[:3, 3], min_clearance=config.motion.min_clearance
            )
        with self._timed("planes"):
            used = self.mapper.map.parameters[:, : self.mapper.map.count]
            points = MapPoints.from_log_scales(used[MEAN], used[LOG_SCALE])
            self.planes.assess(space_state=self.volume.state_at, map_points=points)
        self._offer()

    def _offer(self) -> None:
        """Build the table of the current stage and its features; other rows get zeros."""
        config = self.config
        with self._timed("planning"):
            offering = Offering(self, self._sources, self._sources_seed)
            self.candidates = offering.table(self._offered)
            if not len(self.candidates):  # no candidates: offer again every stage not known to be empty
                self._empty.add(self.stage)
                self.candidates = offering.table(self._empty)
        with self._timed("features"):
            views = self.candidates.views
            context = self.feature_context(self.candidates.world_from_camera[:views], self.candidates.revisit[:views])
            features, visible = evaluate_features(config.features, context), context.visible
            self.features = np.zeros((len(self.candidates), features.shape[1]), features.dtype)
            self.visible = np.zeros((len(self.candidates), visible.shape[1]), visible.dtype)
            self.features[:views], self.visible[:views] = features, visible
            # A row that ends the episode has a pose but gets no features.
            self.features[self.candidates.ends], self.visible[self.candidates.ends] = 0.0, False
