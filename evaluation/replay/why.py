"""Explain a decision of a finished run: its best rows, their features, the truth, and the choices of other policies."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from activestructure_gym.envs.observation import CANDIDATE_COLUMNS, feature_columns, feature_names
from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive.decisions import Row
from activestructure_gym.evaluation.archive.jobs import refuse_code
from activestructure_gym.evaluation.archive.store import CONFIG, DECISIONS, Run
from activestructure_gym.evaluation.replay.reasons import reason
from activestructure_gym.evaluation.replay.recording import replay_env
from activestructure_gym.evaluation.replay.true_areas import TrueAreas
from activestructure_gym.policies import Candidates, make_policy


@dataclass(frozen=True)
class ExplainedRow:
    """Hold one candidate of a decision.

    Attributes
    ----------
    row
        Row of the candidate table.
    rank
        Rank by the run's policy, from 1; None if only another policy chose the row.
    score
        Score by the run's policy; None if it compared no scores.
    position
        [3] camera position in metres, world.
    yaw_deg, pitch_deg
        View direction in degrees: yaw 0 = +x, positive pitch = up.
    metres, frames
        Length of the path and frames until arrival.
    terms, features
        Terms of the score, and features of the run's policy by column name.
    new_m2
        True surface in square metres that the keyframes on the path would show and that no keyframe has seen; None
        if the truth was not asked for, without ground truth, or without a path.
    chosen_by
        Names of the policies that choose this row.
    """

    row: int
    rank: int | None
    score: float | None
    position: tuple[float, float, float]
    yaw_deg: float
    pitch_deg: float
    metres: float
    frames: int
    terms: dict[str, float]
    features: dict[str, float]
    new_m2: float | None
    chosen_by: tuple[str, ...]


@dataclass(frozen=True)
class Explanation:
    """Hold one decision of a run: its rows by rank, the policy's own numbers, and the number of candidates."""

    decision: int  # number of the decision, from 0
    frame: int  # frames used before the decision
    candidates: int
    reason: str  # sentences on the choice; see `reasons.reason`
    rows: list[ExplainedRow]
    trace: dict[str, Any]  # numbers of the policy on its choice; see `Policy.trace`
    divergence: str = ""  # sentence if the replay offers other views than the stored run; empty if not


def explain(
    run: Run,
    decision: int,
    others: Sequence[str] = (),
    report_progress: Callable[[int, int], None] = lambda done, of: None,
    *,
    truth: bool = False,
    trusted: bool = False,
) -> Explanation:
    """Describe a decision of a run from its files.

    Only the truth and the choices of other policies need a replay up to the decision. Other policies see every
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
    truth
        Whether to measure the true surface that each row would show.
    trusted
        Whether code that the run's files name may be executed.

    Returns
    -------
    Explanation
        The decision.

    Raises
    ------
    InputError
        If there is no such decision, if the run stores no rows of its decisions, or as in `play_again`.
    """
    if not run.steps:
        raise InputError(f"'{run.job.title}' has no decisions")
    if run.job.policy.kind in ("reference", "trajectory"):
        raise InputError(f"'{run.job.title}' has no policy whose decisions can be explained")
    if not 0 <= decision < len(run.steps):
        raise InputError(
            f"'{run.job.title}' has {len(run.steps)} decisions, numbered from 0; there is no decision {decision}"
        )
    if run.decisions is None:
        raise InputError(f"'{run.directory}' lacks {DECISIONS}, which holds the rows of its decisions: run it again")
    best = run.decisions[decision]
    rows, new_areas, choices, divergence = list(best), dict[int, float](), {str(run.job.policy): best[0].row}, ""
    if others or (truth and run.has_truth):
        more, new_areas, chosen, divergence = _played(run, decision, others, report_progress, truth, trusted)
        rows, choices = [*rows, *more], choices | chosen
    step, before = run.steps[decision], run.steps[decision - 1] if decision else run.metrics["curve"][0]
    return Explanation(
        decision=decision,
        frame=int(before["frames"]),
        candidates=int(step.get("candidates", 0)),
        reason=reason(run.policy, best),
        rows=[
            _explained(row, rank if rank <= len(best) else None, new_areas.get(row.row), choices)
            for rank, row in enumerate(rows, start=1)
        ],
        trace=step.get("trace") or {},
        divergence=divergence,
    )


def _played(
    run: Run,
    decision: int,
    others: Sequence[str],
    report_progress: Callable[[int, int], None],
    truth: bool,
    trusted: bool,
) -> tuple[list[Row], dict[int, float], dict[str, int], str]:
    """Play a run again up to a decision.

    Return the rows that only other policies choose, the true new areas in m^2 by row, the choices by policy, and a
    sentence if the replay offers other views than the stored run.
    """
    assert run.decisions is not None
    best, policies = run.decisions[decision], {name: make_policy(name) for name in dict.fromkeys(others)}
    if policies and not trusted:  # the run's policy is made for the names of its features
        refuse_code([run.job], run.directory / CONFIG)
    own = make_policy(run.job.policy).required_features if policies else ()
    features = tuple(dict.fromkeys([*own, *(name for p in policies.values() for name in p.required_features)]))
    with replay_env(run, features=features, trusted=trusted) as env:
        for policy in policies.values():
            policy.bind(env)
            policy.reset(run.job.seed)
        observation = env.observation()
        for number, step in enumerate(run.steps[:decision]):
            for policy in policies.values():
                policy.act(observation)
            observation, *_ = env.step(np.int64(step["action"]))
            report_progress(number + 1, decision)
        choices = {name: int(policy.act(observation)) for name, policy in policies.items()}
        new = dict.fromkeys(row for row in choices.values() if row not in {row.row for row in best})
        candidates, columns = Candidates(observation, feature_names(env)), feature_columns(*own)
        more = [_unscored(candidates, observation["candidates"][row], row, columns) for row in new]
        views = observation["candidates"][[row.row for row in best], : len(CANDIDATE_COLUMNS)]
        same = np.array_equal(views, np.array([list(row.view.values()) for row in best], np.float32))
        areas = TrueAreas(env.reconstruction).new([row.row for row in [*best, *more]]) if truth else {}
    return more, areas, choices, "" if same else f"decision {decision}: the replay offers other views than the run"


def _unscored(candidates: Candidates, view: np.ndarray, row: int, columns: Sequence[str]) -> Row:
    features = {name: float(candidates[name][row]) for name in columns}
    return Row(row, None, dict(zip(CANDIDATE_COLUMNS, map(float, view))), features, {})


def _explained(row: Row, rank: int | None, new_m2: float | None, choices: dict[str, int]) -> ExplainedRow:
    view = row.view
    return ExplainedRow(
        row=row.row,
        rank=rank,
        score=row.score,
        position=(view["x"], view["y"], view["z"]),
        yaw_deg=float(np.degrees(np.arctan2(view["look_y"], view["look_x"]))),
        pitch_deg=float(np.degrees(np.arcsin(np.clip(view["look_z"], -1.0, 1.0)))),
        metres=view["path_length"],
        frames=int(view["frames"]),
        terms=row.terms,
        features=row.features,
        new_m2=new_m2,
        chosen_by=tuple(name for name, choice in choices.items() if choice == row.row),
    )
