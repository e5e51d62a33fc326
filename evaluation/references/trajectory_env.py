"""Follow the trajectory of a job, frame by frame, through the sensor, the map and the protocols of every other run."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from activestructure_gym.config import configure
from activestructure_gym.envs import ReconstructionEnv
from activestructure_gym.envs.reconstruction_env import as_pose
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.references.trajectory import ResolvedTrajectory, TrajectorySpec
from activestructure_gym.evaluation.trajectories.motion import motion_report
from activestructure_gym.motion import PathSegment, regular_segments

if TYPE_CHECKING:
    from activestructure_gym.ground_truth import GroundTruth


class TrajectoryEnv(ReconstructionEnv):
    """An environment in which every step, whatever the action, is the next leg of a trajectory."""

    course: ResolvedTrajectory

    def __init__(self, course: ResolvedTrajectory | None, truth: GroundTruth, **options: Any) -> None:
        given = {} if course is None else {"start_pose": course.poses[0]}
        super().__init__(**options | given, scene=truth)
        self._given, self._truth = course, truth
        self._next = 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Begin where the trajectory begins; a sweep begins where any episode would."""
        self._next = 0
        begun = super().reset(seed=seed, options=options)
        self.course = self._given or self._sweep()
        return begun

    def _as_start(self, value: Sequence[float] | np.ndarray) -> np.ndarray:  # [4, 4]
        return as_pose(value)  # a camera in somebody's hand rolls

    def _sweep(self) -> ResolvedTrajectory:
        from activestructure_gym.evaluation.references.sweep import sweep

        config = self.config
        poses = sweep(self._truth.free_space, self.reconstruction.pose, config.frame_budget, config.motion)
        return ResolvedTrajectory(poses, regular_segments(poses, config.keyframe_every))

    def step(self, action: Any) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """Follow the next leg; terminates with the last one."""
        self._access.check_open("step")
        legs = self.course.legs
        leg = legs[self._next] if self._next < len(legs) else PathSegment(self.course.poses[:0], ())
        self._next += 1
        observation, reward, _, truncated, info = self._outcome(self.reconstruction.follow(leg), invalid=False)
        return observation, reward, self._next >= len(legs), truncated, info


class TrajectoryPolicy:
    """In place of a policy: decides nothing."""

    def reset(self, seed: int) -> None:
        """Nothing is drawn."""

    def act(self, observation: dict[str, np.ndarray]) -> int:
        """Any row: `TrajectoryEnv` takes none."""
        return 0

    def trace(self) -> dict[str, Any]:
        """Nothing was weighed."""
        return {}


def trajectory_policy_and_env(job: Job, known: GroundTruth) -> tuple[TrajectoryPolicy, TrajectoryEnv]:
    """Who follows the trajectory of a job, and its env."""
    given = TrajectorySpec.of(job.policy)
    changes = given.changes(job.conditions.overrides)
    config = configure(job.conditions.preset, changes)
    resolved = given.course(known, config.keyframe_every)
    env = TrajectoryEnv(resolved, known, features=(), **job.conditions.env_options(changes))
    return TrajectoryPolicy(), env


def followed_metrics(env: TrajectoryEnv) -> dict[str, float]:
    """How the trajectory moved beside the limits of planners, and how many of its poses stand in something."""
    motion, executed = env.config.motion, np.stack(env.reconstruction.trajectory)
    told = motion_report(executed, max_step_m=motion.max_step_m, max_turn_deg=motion.max_turn_deg)
    return {**told, "poses_outside": env.course.outside}
