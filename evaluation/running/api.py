"""Run a comparison with one call, for notebooks and scripts: like ``asg compare``, without output and report."""

from __future__ import annotations

import itertools
import os
import warnings
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from activestructure_gym.errors import InputError, InputWarning, short_repr
from activestructure_gym.evaluation.archive.conditions import Conditions
from activestructure_gym.evaluation.archive.directory_lock import hold
from activestructure_gym.evaluation.archive.jobs import Job, named_in
from activestructure_gym.evaluation.running.comparison import Comparison, Result, run_comparison
from activestructure_gym.evaluation.running.engines import Limits, Listener, Outcome
from activestructure_gym.evaluation.running.episode import Progress
from activestructure_gym.evaluation.running.output_directory import check_output
from activestructure_gym.scenes.library import SCENES
from activestructure_gym.specs import Spec
from activestructure_gym.worlds import names_world
from activestructure_gym.worlds.registry import PREFIX, WORLDS

if TYPE_CHECKING:
    from activestructure_gym.registry import Registry


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
    sweep: Mapping[str, Sequence[Any]] | None = None,
    engine: str = "local",
    limits: Limits | None = None,
    listener: Listener | None = None,
    resume: bool = False,
) -> Result:
    """Run policies on scenes under one budget and measure the finished maps.

    Runs with equal seeds share start, sensor noise and planner noise, so that policies are compared in pairs. Finished
    runs in ``out`` are not repeated, unless their files are damaged or their plug-in code has changed. In both cases an
    `InputWarning` is given. ``asg report OUT`` creates the report.

    Parameters
    ----------
    scenes
        Scene specs as `load_scene` takes them: ``"room?seed=3"``, ``"house.glb"``.
    policies
        Names with options: ``"activestructure"``, ``"active_gs?travel=shared"``, ``"package.module:Class"``.
    out
        The directory of the comparison; new or empty, unless ``resume`` is set.
    seeds
        Whole numbers from 0.
    conditions
        Configuration, budget, start and protocols of all runs. Default: `Conditions()`.
    sweep
        Values by configuration field: every policy runs with each of them, on top of the conditions. Several fields
        give all combinations. Example: ``{"mapper.seed_spacing": (0.06, 0.12)}``.
    engine
        ``"local"`` (a process per run), ``"inline"`` (this process) or ``"ray"``.
    limits
        Runs at a time, minutes per attempt, further attempts.
    listener
        Receives the progress of the runs. Default: `NullListener`.
    resume
        Whether to continue the comparison in ``out``.

    Returns
    -------
    Result
        ``runs`` (all finished runs, also those of earlier calls), ``failed``, ``skipped``, ``missing``.

    Raises
    ------
    InputError
        A name, a file or a number is invalid, or the directory is in use. It is raised before the first run.

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
    for name, given, like in (("scenes", scenes, "box"), ("policies", policies, "random"), ("seeds", seeds, 0)):
        if isinstance(given, str) or not isinstance(given, Iterable):
            raise InputError(f"{name} are a list, as {[like]}, got {short_repr(given)}")
    settings: list[tuple[str, Any, type]] = [("conditions", conditions, Conditions), ("limits", limits, Limits)]
    for name, value, kind in settings:
        if value is not None and not isinstance(value, kind):
            raise InputError(f"{name} must be {kind.__name__}(...), got {short_repr(value)}")
    comparison = Comparison(
        [*map(Spec, scenes)], [*map(Spec, policies)], seeds, conditions=conditions or Conditions(), sweep=sweep or {}
    )
    directory = Path(out)
    check_output(directory, resume=resume)
    if engine != "inline":
        refuse_names_of_this_process(comparison)
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
            notify=_warn,
        )


def refuse_names_of_this_process(comparison: Comparison) -> None:
    """Raise `InputError` for a registered name that is unknown in the processes of the runs.

    These import only this package, installed plug-ins, and the modules that the comparison names as ``module:Name``.
    """
    named: list[tuple[Registry[Any], Spec]] = []
    for spec in comparison.scenes:
        registry, name = (WORLDS, spec.removeprefix(PREFIX)) if names_world(spec) else (SCENES, spec)
        named += [(registry, Spec(name)), (registry, Spec(name.partition(":")[0]))]  # "mesh" of "mesh:house.obj"
    for policy, conditions in itertools.product(comparison.policies, comparison.all_conditions):
        named += named_in(Job(Spec(""), policy, 0, conditions=conditions))
    imported = {registry.module_of(name.name) for registry, name in named}
    for registry, name in named:
        if (module := registry.only_here(name.name)) and module not in imported:
            raise InputError(
                f"the {registry.kind} '{name.name}' is registered in this process only, and every run has a process "
                "of its own: name it as package.module:Name, or use engine='inline'"
            )


def _warn(text: str) -> None:
    warnings.warn(text, InputWarning, stacklevel=3)
