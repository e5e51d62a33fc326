"""A comparison in one call, for notebooks and scripts: what ``asg compare`` does, without words and a report."""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from pathlib import Path

from activestructure_gym.errors import InputError, InputWarning, short_repr
from activestructure_gym.evaluation.archive.conditions import Conditions
from activestructure_gym.evaluation.archive.directory_lock import hold
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.running.comparison import Comparison, Result, check_output, run_comparison
from activestructure_gym.evaluation.running.engines import Limits, Listener, Outcome
from activestructure_gym.evaluation.running.episode import Progress


class NullListener:
    """Ignore all events of a `Listener`."""

    def begin(self, jobs: Sequence[Job], finished: int) -> None:
        """See `Listener`."""

    def progress(self, job: Job, progress: Progress) -> None:
        """See `Listener`."""

    def on_retry(self, job: Job, error: str) -> None:
        """See `Listener`."""

    def ended(self, outcome: Outcome) -> None:
        """See `Listener`."""


def compare(
    scenes: Sequence[str],
    policies: Sequence[str],
    out: str | os.PathLike[str],
    *,
    seeds: Sequence[int] = (0,),
    conditions: Conditions | None = None,
    engine: str = "local",
    limits: Limits | None = None,
    listener: Listener | None = None,
    resume: bool = False,
) -> Result:
    """Run policies on scenes under one budget and measure the finished maps.

    Equal seeds share start, sensor noise and planner noise, so that policies are compared in pairs. What is finished
    in ``out`` is not run again unless it is damaged or other own code played it, of which an `InputWarning` tells.
    ``asg report OUT`` draws the pages.

    Parameters
    ----------
    scenes
        Texts as `load_scene` takes them: ``"room?seed=3"``, ``"house.glb"``.
    policies
        Names with options: ``"activestructure"``, ``"active_gs?travel=shared"``, ``"package.module:Class"``.
    out
        The directory of the comparison; new or empty, unless ``resume``.
    seeds
        Whole numbers from 0 on.
    conditions
        Configuration, budget, start and protocols of all runs; the defaults if not given.
    engine
        ``"local"`` (a process per run), ``"inline"`` (this process) or ``"ray"``.
    limits
        Runs at a time, minutes per run, further attempts.
    listener
        Who is told how the runs get on; nobody if not given.
    resume
        Go on with the comparison in ``out``.

    Returns
    -------
    Result
        ``runs`` (every finished run, those of earlier sittings included), ``failed``, ``skipped``, ``missing``.

    Raises
    ------
    InputError
        Before anything is run: a name, a file or a number that cannot be used, or a directory that is not free.

    Examples
    --------
    >>> import tempfile
    >>> from activestructure_gym.evaluation import Conditions, StandardProtocol, compare
    >>> protocol = StandardProtocol(views=1, surface_samples=2000, points_source="means")
    >>> conditions = Conditions(preset="fast", frame_budget=2, protocol=protocol)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     result = compare(["box"], ["random"], folder, conditions=conditions, engine="inline")
    ...     [(run.policy, run.metrics["metrics"]["psnr"] > 0) for run in result.runs]
    [('random', True)]
    """
    for name, given in (("scenes", scenes), ("policies", policies)):
        if isinstance(given, str):
            raise InputError(f"{name} are a list of names, as ['{given}'], got the text {short_repr(given)}")
    comparison = Comparison(scenes, policies, seeds, conditions=conditions or Conditions())
    directory = Path(out)
    check_output(directory, resume=resume)
    jobs = comparison.prepare()
    with hold(directory) as held:
        return run_comparison(
            jobs,
            directory,
            listener or NullListener(),
            engine=engine,
            limits=limits,
            resume=resume,
            held=held,
            tell=_warn,
        )


def _warn(text: str) -> None:
    warnings.warn(text, InputWarning, stacklevel=3)
