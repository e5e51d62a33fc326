"""Create what acts in a job (a policy, a reference or a given trajectory), and its environment."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from activestructure_gym.errors import InputError, short_repr
from activestructure_gym.evaluation.archive.jobs import Job

if TYPE_CHECKING:
    from activestructure_gym.envs import ReconstructionEnv
    from activestructure_gym.ground_truth import GroundTruth
    from activestructure_gym.worlds import World


class Actor(Protocol):
    """Define the interface of a policy or a reference: choose a row of the candidate table at every decision."""

    def reset(self, seed: int) -> None:
        """Begin an episode."""

    def act(self, observation: dict[str, np.ndarray]) -> int:
        """Return the chosen row of the candidate table."""

    def trace(self) -> dict[str, Any]:
        """Return the numbers that led to the last choice."""


def chosen_row(policy: str, env: ReconstructionEnv, row: Any) -> int:
    """Return the ``row`` that a policy chose; raise `InputError` if it is not a row of the candidate table."""
    if not env.is_row(row):
        last = int(env.action_space.n) - 1
        raise InputError(
            f"policy '{policy}': act() must return a row, a whole number from 0 to {last}, got {short_repr(row)}"
        )
    return int(row)


def build(job: Job, explored: GroundTruth | World) -> tuple[Actor, ReconstructionEnv]:
    """Create the actor of a job (policy, reference or trajectory) and its environment with the required features.

    Only a reference receives the ground truth.
    """
    from activestructure_gym.envs import ReconstructionEnv
    from activestructure_gym.ground_truth import GroundTruth
    from activestructure_gym.policies import make_policy

    if job.policy.kind == "reference":
        assert isinstance(explored, GroundTruth)
        from activestructure_gym.evaluation.references.oracles import WHOLE_POOL, make_reference

        changes = dict(job.conditions.overrides) | {"views.max_candidates": WHOLE_POOL}
        env = ReconstructionEnv(scene=explored, features=(), **job.conditions.env_options(changes))
        return make_reference(job.policy, env, explored, job.conditions.protocol), env
    if job.policy.kind == "trajectory":
        from activestructure_gym.evaluation.references.trajectory_env import trajectory_policy_and_env

        assert isinstance(explored, GroundTruth)
        return trajectory_policy_and_env(job, explored)
    policy = make_policy(job.policy)
    options = job.conditions.env_options(job.conditions.changes(policy))
    env = ReconstructionEnv(scene=explored, features=tuple(policy.required_features), **options)
    policy.bind(env)
    return policy, env
