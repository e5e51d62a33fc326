"""Explain a decision of a finished run: its best rows, their features, the truth, and the choices of other policies."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from activestructure_gym.envs.observation import feature_columns
from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.replay.recording import replay_env
from activestructure_gym.policies import Policy, make_policy

if TYPE_CHECKING:
    from activestructure_gym.envs import ReconstructionEnv
    from activestructure_gym.reconstruction import Reconstruction

BEST = 5  # rows of the run's own policy in an explanation


@dataclass(frozen=True)
class ExplainedRow:
    """Hold one candidate of a decision.

    Attributes
    ----------
    row
        Row of the candidate table.
    rank
        Rank by the run's policy, from 1; None if only another policy chose the row.
    position
        [3] camera position in metres, world.
    yaw_deg, pitch_deg
        View direction in degrees: yaw 0 = +x, positive pitch = up.
    metres, frames
        Length of the path and frames until arrival.
    features
        Features of the run's policy by column name.
    new_m2
        True surface in square metres that the keyframes on the path would show and that no keyframe has seen; None
        without ground truth or without a path.
    chosen_by
        Names of the policies that choose this row.
    """

    row: int
    rank: int | None
    position: tuple[float, float, float]
    yaw_deg: float
    pitch_deg: float
    metres: float
    frames: int
    features: dict[str, float]
    new_m2: float | None
    chosen_by: tuple[str, ...]


@dataclass(frozen=True)
class Explanation:
    """Hold one decision of a run: its rows by rank, the policy's own numbers, and the number of candidates."""

    decision: int  # number of the decision, from 0
    frame: int  # frames used before the decision
    candidates: int
    rows: list[ExplainedRow]
    trace: dict[str, Any]  # numbers of the policy on its choice; see `Policy.trace`
    divergence: str = ""  # sentence if the policy chose another row than in the stored run; empty if not


def explain(
    run: Run,
    decision: int,
    others: Sequence[str] = (),
    report_progress: Callable[[int, int], None] = lambda done, of: None,
    *,
    trusted: bool = False,
) -> Explanation:
    """Play a run again up to a decision, and describe the decision.

    Rows are ranked by asking the policy again without the rows that it has chosen already. Other policies see every
    observation from the start of the episode, and their choices are not executed.

    Parameters
    ----------
    run
        The finished run of a policy.
    decision
        Number of the decision, from 0.
    others
        Specs of other policies.
    report_progress
        Called with the number of replayed decisions and the number to replay.
    trusted
        Whether code that the run's files name may be executed.

    Returns
    -------
    Explanation
        The decision.

    Raises
    ------
    InputError
        If there is no such decision, if the run has no policy of its own, or as in `play_again`.
    """
    if not run.steps:
        raise InputError(f"'{run.job.title}' has no decisions")
    if run.job.policy.kind in ("reference", "trajectory"):
        raise InputError(f"'{run.job.title}' has no policy whose decisions can be explained")
    if not 0 <= decision < len(run.steps):
        raise InputError(
            f"'{run.job.title}' has {len(run.steps)} decisions, numbered from 0; there is no decision {decision}"
        )
    policies = {str(spec): make_policy(spec) for spec in dict.fromkeys([run.job.policy, *others])}
    features = tuple(dict.fromkeys(name for policy in policies.values() for name in policy.required_features))
    with replay_env(run, features=features, trusted=trusted) as env:
        for policy in policies.values():
            policy.bind(env)
            policy.reset(run.job.seed)
        observation, divergence = env.observation(), ""
        for number, step in enumerate(run.steps[:decision]):
            for name, policy in policies.items():
                row = policy.act(observation)
                if name == run.job.policy and row != step["action"] and not divergence:
                    divergence = f"decision {number}: the policy now chooses row {row}, in the run row {step['action']}"
            observation, *_ = env.step(np.int64(step["action"]))
            report_progress(number + 1, decision)
        return _explained(run, decision, env, observation, policies, divergence)


def _explained(
    run: Run,
    decision: int,
    env: ReconstructionEnv,
    observation: dict[str, np.ndarray],
    policies: dict[str, Policy],
    divergence: str,
) -> Explanation:
    own, *others = policies
    ranked = ranked_rows(policies[own], observation, BEST)
    choices = {own: int(run.steps[decision]["action"])} | {name: policies[name].act(observation) for name in others}
    policies[own].act(observation)  # for its trace
    rows = list(dict.fromkeys([*ranked, *choices.values()]))
    episode = env.reconstruction
    new_areas = _new_areas(episode, rows)
    candidates, columns = policies[own].candidates(observation), feature_columns(*policies[own].required_features)
    look = candidates.view_direction
    return Explanation(
        decision=decision,
        frame=episode.frames,
        candidates=int(observation["action_mask"].sum()),
        rows=[
            ExplainedRow(
                row=row,
                rank=ranked.index(row) + 1 if row in ranked else None,
                position=tuple(float(value) for value in candidates.xyz[row]),  # type: ignore[arg-type]
                yaw_deg=float(np.degrees(np.arctan2(look[row, 1], look[row, 0]))),
                pitch_deg=float(np.degrees(np.arcsin(np.clip(look[row, 2], -1.0, 1.0)))),
                metres=float(candidates.path_length[row]),
                frames=int(candidates.frames[row]),
                features={name: float(candidates[name][row]) for name in columns},
                new_m2=new_areas.get(row),
                chosen_by=tuple(name for name, choice in choices.items() if choice == row),
            )
            for row in rows
        ],
        trace=policies[own].trace(),
        divergence=divergence,
    )


def ranked_rows(policy: Policy, observation: dict[str, np.ndarray], count: int) -> list[int]:
    """Return up to ``count`` rows in the order in which the policy chooses them, each without those before.

    Copies of the policy are asked, so its state does not change.
    """
    mask, rows = observation["action_mask"].copy(), list[int]()
    while mask.any() and len(rows) < count:
        row = int(copy.deepcopy(policy).act({**observation, "action_mask": mask.copy()}))
        if not (0 <= row < len(mask) and mask[row]):
            break
        rows.append(row)
        mask[row] = 0
    return rows


def _new_areas(episode: Reconstruction, rows: Sequence[int]) -> dict[int, float]:
    """Return the unseen true surface in m^2 that the path to each row would show.

    Rows without a path are left out; all rows are without ground truth.
    """
    from activestructure_gym.evaluation.references.oracle_gains import TrueSurface
    from activestructure_gym.worlds import SceneWorld

    if not isinstance(episode.world, SceneWorld):
        return {}
    surface = TrueSurface(episode.world.truth)
    surface.follow(episode)
    valid = [row for row in rows if row < len(episode.candidates)]
    paths = episode.agent.paths(episode.volume, episode.candidates.world_from_camera[valid])
    return {row: surface.new_area(episode, path.keyframes) for row, path in zip(valid, paths) if path is not None}
