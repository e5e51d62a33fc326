"""Play a stored run again, action by action, and keep what can be watched of it.

The actions stand in ``steps.jsonl`` and everything else in ``config.json``, so the same code on the same machine plays
the same episode: the map of every moment need not be stored with every run.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive.jobs import is_reference, is_trajectory, refuse_code
from activestructure_gym.evaluation.archive.store import CONFIG, STEPS, Run
from activestructure_gym.viewer import Film, Recorder

if TYPE_CHECKING:
    from activestructure_gym.envs import ReconstructionEnv

_MAX_BYTES = 150 << 20  # of the moments of a replay: browsers read texts of up to 500 MB


@dataclass(frozen=True)
class Recording(Film):
    """A finished run as it can be watched."""

    run: Run
    differs: str = ""  # where this code plays another episode than the stored one, in words


def play_again(
    run: Run, tell: Callable[[int, int], None] = lambda frames, budget: None, *, trusted: bool = False
) -> Recording:
    """The episode of ``run``, played again; ``tell`` hears how many frames of how many are done.

    Raises `InputError` where the scene is not there any more or has changed, for a mapper without Gaussians, and where
    the run's files name code and are not ``trusted``; see `registry.refuse_code`.
    """
    with playing(run, trusted=trusted) as env:
        recorder = Recorder(env.reconstruction, most_bytes=_MAX_BYTES)
        differs = follow(run, env, recorder.note, tell)
        recorder.note(end=True)
        film = recorder.film()
    return Recording(**{field.name: getattr(film, field.name) for field in fields(film)}, run=run, differs=differs)


@contextmanager
def playing(run: Run, *, trusted: bool = False) -> Iterator[ReconstructionEnv]:
    """The environment of ``run`` at its start; raises what `play_again` does."""
    from activestructure_gym.envs import ReconstructionEnv
    from activestructure_gym.evaluation.references.trajectory import trajectory_policy_and_env
    from activestructure_gym.evaluation.running.recorded_scene import load_job_scene
    from activestructure_gym.ground_truth import ground_truth_of

    job, stored = run.job, run.config["configuration"]
    if "features" not in stored or "max_candidates" not in stored.get("views", {}):
        raise InputError(f"'{run.directory / CONFIG}' lacks features or views.max_candidates: no replay without")
    if not trusted:  # a policy is made in the native setup alone, to learn what it brings
        refuse_code(
            [job if job.conditions.setup == "native" else replace(job, policy="random")], run.directory / CONFIG
        )
    truth = ground_truth_of(load_job_scene(job))
    env: ReconstructionEnv
    if is_trajectory(job.policy):
        env = trajectory_policy_and_env(job, truth)[1]
    else:
        changes = {**_changes(run), "views.max_candidates": stored["views"]["max_candidates"]}
        options = job.conditions.env_options(changes) | {"frame_budget": stored["frame_budget"]}
        features = () if is_reference(job.policy) else _at_hand(stored["features"])
        env = ReconstructionEnv(scene=truth, features=features, **options)
    try:
        env.reset(seed=job.seed)
        yield env
    finally:
        env.close()


def follow(run: Run, env: ReconstructionEnv, before: Callable[[int], object], tell: Callable[[int, int], None]) -> str:
    """Take the stored actions, each after ``before`` has heard it; from where on it is another episode, in words."""
    episode, differs = env.reconstruction, ""
    for number, step in enumerate(run.steps, start=1):  # a report does without, of whoever wrote them
        if lacks := [name for name in ("decision", "action", "gaussians", "metres") if step.get(name) is None]:
            raise InputError(f"line {number} of '{run.directory / STEPS}' lacks {', '.join(lacks)}: no replay without")
    for step in run.steps:
        before(int(step["action"]))
        _, _, terminated, truncated, info = env.step(int(step["action"]))
        if not differs and (info["frames"] != step["frames"] or info["gaussians"] != step["gaussians"]):
            differs = (
                f"from decision {step['decision']} on this machine plays another episode: {info['frames']} frames and "
                f"{info['gaussians']} Gaussians, and in the run {step['frames']} and {step['gaussians']}"
            )
        tell(info["frames"], episode.frame_budget)
        if terminated or truncated:
            if not differs and step is not run.steps[-1]:
                differs = f"after decision {step['decision']} the episode ends on this machine, and goes on in the run"
            break
    return differs


def _changes(run: Run) -> dict[str, Any]:
    """What the configuration differs in from the preset's: what was asked for, and what the policy brought."""
    from activestructure_gym.policies import make_policy

    if run.job.conditions.setup == "shared":
        return dict(run.job.conditions.overrides)
    return run.job.conditions.changes(make_policy(run.job.policy))


def _at_hand(features: list[str]) -> tuple[str, ...]:
    """The features that can be evaluated here and run no code of others: only colours depend on them."""
    from activestructure_gym.features import FEATURES

    return tuple(name for name in features if ":" not in name and any(name.startswith(known) for known in FEATURES))[:1]
