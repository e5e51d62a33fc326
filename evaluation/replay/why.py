"""Explain a decision of a finished run: its best rows, their features, the truth, and the choices of other policies."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

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

    run: Run
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
    seen = {row: area for row, area in zip(rows, _new_areas(run, episode, rows))}
    candidates, named = policies[own].candidates(observation), policies[own].required_features
    columns = [name for name in env.config.features if any(name.startswith(wanted) for wanted in named)]
    table = observation["candidates"]
    return Explanation(
        run=run,
        decision=decision,
        frame=episode.frames,
        candidates=int(observation["action_mask"].sum()),
        rows=[
            ExplainedRow(
                row=row,
                rank=ranked.index(row) + 1 if row in ranked else None,
                position=tuple(float(value) for value in table[row, 0:3]),  # type: ignore[arg-type]
                yaw_deg=float(np.degrees(np.arctan2(table[row, 4], table[row, 3]))),
                pitch_deg=float(np.degrees(np.arcsin(np.clip(table[row, 5], -1.0, 1.0)))),
                metres=float(candidates.path_length[row]),
                frames=int(candidates.frames[row]),
                features={name: float(candidates[name][row]) for name in columns},
                new_m2=seen[row],
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


def _new_areas(run: Run, episode: Reconstruction, rows: Sequence[int]) -> list[float | None]:
    """Return the unseen true surface in m^2 that the path to each row would show; None without ground truth."""
    if not run.has_truth:
        return [None] * len(rows)
    from activestructure_gym.evaluation.references.oracle_gains import TrueSurface
    from activestructure_gym.evaluation.running.surroundings import scene_surroundings

    known = scene_surroundings(run.job).known
    assert known is not None
    surface = TrueSurface(known)
    surface.follow(episode)
    valid = [row for row in rows if row < len(episode.candidates)]
    paths = episode.agent.paths(episode.volume, episode.candidates.world_from_camera[valid])
    found = {
        row: None if path is None else surface.new_area(episode, path.keyframes) for row, path in zip(valid, paths)
    }
    return [found.get(row) for row in rows]
