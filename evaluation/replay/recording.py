"""Replay a stored run action by action, and record it for the viewer.

``steps.jsonl`` holds the actions and ``config.json`` all settings. The same code on the same machine
plays the same episode. So the run directory need not contain the map at every decision.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive.jobs import refuse_code
from activestructure_gym.evaluation.archive.store import CONFIG, STEPS, Run
from activestructure_gym.evaluation.replay.true_areas import TrueAreas
from activestructure_gym.specs import Spec
from activestructure_gym.viewer import Film, Recorder

if TYPE_CHECKING:
    from activestructure_gym.envs import ReconstructionEnv

_MAX_BYTES = 150 << 20  # maximum size of the recorded decisions; browsers read texts of up to 500 MB


@dataclass(frozen=True)
class Recording(Film):
    """Hold a finished run and its replay for the viewer.

    Parameters
    ----------
    run
        The stored run.
    divergence
        Sentence on the first decision after which the replay differs from the stored run; empty without a difference.
    new_areas
        For each replayed decision, the true surface in m^2 that the chosen view and the runner-up would have shown for
        the first time, by row; empty without ground truth.

    The other fields are those of `activestructure_gym.viewer.Film`.
    """

    run: Run
    divergence: str = ""
    new_areas: Sequence[Mapping[int, float]] = ()


def play_again(
    run: Run, report_progress: Callable[[int, int], None] = lambda frames, budget: None, *, trusted: bool = False
) -> Recording:
    """Replay a stored run and record it.

    Parameters
    ----------
    run
        The stored run.
    report_progress
        Called after each decision with the frames used so far and the frame budget.
    trusted
        Whether code named in the run's files may be executed.

    Returns
    -------
    Recording
        The recorded episode.

    Raises
    ------
    InputError
        If the scene is missing or has changed, if the mapper has no Gaussians, or if the run's files name code and the
        run is not ``trusted`` (see `archive.jobs.refuse_code`).
    """
    with replay_env(run, trusted=trusted) as env:
        recorder = Recorder(env.reconstruction, most_bytes=_MAX_BYTES)
        areas, new_areas = TrueAreas(env.reconstruction), list[dict[int, float]]()

        def note(row: int) -> None:
            recorder.note(row)
            compared = run.decisions[len(new_areas)][:2] if run.decisions else []
            new_areas.append(areas.new([one.row for one in compared]))

        divergence = replay_actions(run, env, note, report_progress)
        recorder.note(end=True)
        film = recorder.film()
    return Recording(
        **{field.name: getattr(film, field.name) for field in fields(film)},
        run=run,
        divergence=divergence,
        new_areas=new_areas,
    )


@contextmanager
def replay_env(
    run: Run, *, trusted: bool = False, features: tuple[str, ...] | None = None
) -> Iterator[ReconstructionEnv]:
    """Yield the environment of a stored run after its reset; raise the errors of `play_again`.

    ``trusted`` allows code named in the run's files. ``features`` are the names of the features to compute. Default:
    the first one of the run that is known.
    """
    from activestructure_gym.envs import ReconstructionEnv
    from activestructure_gym.evaluation.references.trajectory_env import trajectory_policy_and_env
    from activestructure_gym.evaluation.running.surroundings import stored_surroundings

    job, stored = run.job, run.config["configuration"]
    if "features" not in stored or "max_candidates" not in stored.get("views", {}):
        raise InputError(f"'{run.directory / CONFIG}' lacks features or views.max_candidates, which a replay needs")
    if not trusted:  # the policy's code is needed in the native setup only, for its settings
        refuse_code(
            [job if job.conditions.setup == "native" else replace(job, policy=Spec("random"))], run.directory / CONFIG
        )
    where = stored_surroundings(job, run.directory)
    env: ReconstructionEnv
    if job.policy.kind == "trajectory":
        assert where.known is not None
        env = trajectory_policy_and_env(job, where.known)[1]
    else:
        changes = {**_overrides(run), "views.max_candidates": stored["views"]["max_candidates"]}
        options = job.conditions.env_options(changes) | {"frame_budget": stored["frame_budget"]}
        if features is None:
            features = () if job.policy.kind == "reference" else _first_known_feature(stored["features"])
        env = ReconstructionEnv(scene=where.explored, features=features, **options)
    try:
        env.reset(seed=job.seed)
        yield env
    finally:
        env.close()


def replay_actions(
    run: Run,
    env: ReconstructionEnv,
    before: Callable[[int], object],
    report_progress: Callable[[int, int], None],
) -> str:
    """Take the stored actions in ``env``, which `replay_env` has yielded.

    ``before`` is called with each action before the step, and ``report_progress`` after it with the frames used so far
    and the frame budget. Return a sentence on the first difference from the stored run; empty without a difference.
    """
    episode, divergence = env.reconstruction, ""
    for number, step in enumerate(run.steps, start=1):  # only a replay needs these fields
        if lacks := [name for name in ("decision", "action", "gaussians", "metres") if step.get(name) is None]:
            raise InputError(
                f"line {number} of '{run.directory / STEPS}' lacks {', '.join(lacks)}, which a replay needs"
            )
    for step in run.steps:
        before(int(step["action"]))
        _, _, terminated, truncated, info = env.step(int(step["action"]))
        if not divergence and (info["frames"] != step["frames"] or info["gaussians"] != step["gaussians"]):
            divergence = (
                f"the replay differs from the stored run from decision {step['decision']} on: {info['frames']} frames "
                f"and {info['gaussians']} Gaussians instead of {step['frames']} and {step['gaussians']}"
            )
        report_progress(info["frames"], episode.frame_budget)
        if terminated or truncated:
            if not divergence and step is not run.steps[-1]:
                divergence = f"the replay ends after decision {step['decision']}, but the stored run continues"
            break
    return divergence


def _overrides(run: Run) -> dict[str, Any]:
    """Return the run's changes of the preset: the user's overrides and, in the native setup, the policy's settings."""
    from activestructure_gym.policies import make_policy

    if run.job.conditions.setup == "shared" or run.job.policy.kind == "reference":  # references have no settings
        return dict(run.job.conditions.overrides)
    return run.job.conditions.changes(make_policy(run.job.policy))


def _first_known_feature(features: list[str]) -> tuple[str, ...]:
    """Return the first built-in feature of a list, or an empty tuple; the viewer colours the candidates by it.

    Features of plug-ins are left out.
    """
    from activestructure_gym.features import FEATURES

    return tuple(name for name in features if ":" not in name and any(name.startswith(known) for known in FEATURES))[:1]
