"""A comparison in one call, for notebooks and scripts: what ``asg compare`` does, without words and a report."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from activestructure_gym.errors import InputError, InputWarning, shown
from activestructure_gym.evaluation.archive.directory_lock import hold
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.protocols import StandardProtocol
from activestructure_gym.evaluation.running.comparison import Comparison, Result, check_output, run_comparison
from activestructure_gym.evaluation.running.engines import Limits, Listener, Outcome
from activestructure_gym.evaluation.running.episode import Progress
from activestructure_gym.policies.schedule import NATIVE_PRESET, Terms

if TYPE_CHECKING:
    from activestructure_gym.config import Preset


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
    preset: Preset | None = None,
    terms: Terms = "shared",
    frame_budget: int | None = None,
    config: Mapping[str, Any] | None = None,
    start_pose: tuple[float, float, float, float] | None = None,
    protocol: StandardProtocol | None = None,
    also_protocols: Sequence[str] = (),
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
    preset
        ``"fast"``, ``"default"``, ``"full"`` or ``"paper"``; ``"default"`` if not given, on native terms ``"full"``.
    terms
        ``"shared"`` (the same candidates, keyframes and mapper) or ``"native"`` (what each policy brings).
    frame_budget
        Frames of every episode, the first one included; the preset's if not given.
    config
        Changes of the preset by field, ``{"sensor.depth_noise": "kinect"}``.
    start_pose
        Where every episode starts: x, y, z in metres and yaw in degrees (0 = +x), world; drawn from the seed if not
        given.
    protocol
        What maps are measured by; the standard protocol with its usual constants if not given.
    also_protocols
        Names of further protocols, ``"activegamer"``.
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
    >>> from activestructure_gym.evaluation import compare
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     result = compare(["box"], ["random"], folder, preset="fast", frame_budget=2, engine="inline",
    ...                      protocol=StandardProtocol(views=1, surface_samples=2000, points_source="means"))
    ...     [(run.policy, run.metrics["metrics"]["psnr"] > 0) for run in result.runs]
    [('random', True)]
    """
    for name, given in (("scenes", scenes), ("policies", policies), ("also_protocols", also_protocols)):
        if isinstance(given, str):
            raise InputError(f"{name} are a list of names, as ['{given}'], got the text {shown(given)}")
    comparison = Comparison(
        scenes=scenes,
        policies=policies,
        seeds=seeds,
        preset=preset or (NATIVE_PRESET if terms == "native" else "default"),
        terms=terms,
        frame_budget=frame_budget,
        overrides=config or {},
        start_pose=start_pose,
        protocol=protocol or StandardProtocol(),
        also_protocols=also_protocols,
    )
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
