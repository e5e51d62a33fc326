"""Follow the trajectory of a job with the sensor, mapper and protocols of all other runs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from activestructure_gym.config import configure
from activestructure_gym.envs import ReconstructionEnv
from activestructure_gym.envs.inputs import as_pose
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.references.trajectory import ResolvedTrajectory, TrajectorySpec
from activestructure_gym.evaluation.trajectories.motion import motion_report
from activestructure_gym.motion import PathSegment, regular_segments

if TYPE_CHECKING:
    from activestructure_gym.ground_truth import GroundTruth


class TrajectoryEnv(ReconstructionEnv):
    """Follow the next segment of a trajectory at every step, and ignore the action.

    ``resolved`` is the trajectory, or None for a sweep, which is generated at every reset.
    """

    resolved: ResolvedTrajectory

    def __init__(self, resolved: ResolvedTrajectory | None, truth: GroundTruth, **options: Any) -> None:
        start = {} if resolved is None else {"start_pose": resolved.poses[0]}
        super().__init__(**options | start, scene=truth)
        self._given, self._truth = resolved, truth
        self._next = 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Begin at the first pose of the trajectory; a sweep begins at the start pose that the seed draws."""
        self._next = 0
        begun = super().reset(seed=seed, options=options)
        self.resolved = self._given or self._sweep()
        return begun

    def _as_start(self, value: Sequence[float] | np.ndarray) -> np.ndarray:  # [4, 4]
        return as_pose(value)  # unlike in `ReconstructionEnv` the pose may be rolled: a hand-held camera rolls

    def _sweep(self) -> ResolvedTrajectory:
        from activestructure_gym.evaluation.references.sweep import sweep

        config = self.config
        poses = sweep(self._truth.free_space, self.reconstruction.pose, config.frame_budget, config.motion)
        return ResolvedTrajectory(poses, regular_segments(poses, config.keyframe_every))

    def step(self, action: Any) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """Follow the next segment; the episode terminates with the last one."""
        self._access.check_open("step")
        segments = self.resolved.segments
        segment = segments[self._next] if self._next < len(segments) else PathSegment(self.resolved.poses[:0], ())
        self._next += 1
        before = self._gained()
        result = self.reconstruction.follow(segment)
        observation, reward, _, truncated, info = self._outcome(result, before, invalid=False)
        return observation, reward, self._next >= len(segments), truncated, info


class TrajectoryPolicy:
    """Replace the policy in an episode: `TrajectoryEnv` ignores its actions."""

    def reset(self, seed: int) -> None:
        """Begin an episode; the seed is not used."""

    def act(self, observation: dict[str, np.ndarray]) -> int:
        """Return 0."""
        return 0

    def trace(self) -> dict[str, Any]:
        """Return an empty trace."""
        return {}


def trajectory_policy_and_env(job: Job, known: GroundTruth) -> tuple[TrajectoryPolicy, TrajectoryEnv]:
    """Create a policy without effect, and the environment that follows the trajectory of a job.

    ``known`` is the ground truth of the job's scene.
    """
    given = TrajectorySpec.of(job.policy)
    changes = given.changes(job.conditions.overrides)
    config = configure(job.conditions.preset, changes)
    resolved = given.resolve(known, config.keyframe_every)
    env = TrajectoryEnv(resolved, known, features=(), **job.conditions.env_options(changes))
    return TrajectoryPolicy(), env


def followed_metrics(env: TrajectoryEnv) -> dict[str, float]:
    """Return the motion statistics of the executed trajectory, and its number of poses outside the free space.

    The statistics compare steps (metres) and turns (degrees) with the motion limits, see `motion_report`. With a
    reference trajectory the errors of `trajectory_errors` are added.
    """
    motion, executed = env.config.motion, np.stack(env.reconstruction.trajectory)
    report = motion_report(executed, max_step_m=motion.max_step_m, max_turn_deg=motion.max_turn_deg)
    return {**report, "poses_outside": env.resolved.outside, **env.resolved.errors}
