"""Write and read run directories. A run is written completely or not at all, as JSON, JSON lines, npz and PLY.

A comparison's directory::

    compare.json                 the grid: jobs, command, versions, machine.
    jobs/<job name>/             one per finished job.
        .done                    completion marker: the job's hash, then the SHA-256 of every file that is read back,
                                 as sha256sum prints it. A directory without it is not a result.
        .played                  marker of an episode that was played but not measured yet; see `played`.
        .withdrawn               the former .done of a run whose code has changed, until it is played again.
        config.json              job, protocol, resolved configuration, scene, versions.
        metrics.json             the numbers and the convergence curve, without times.
        evaluations/NAME.json    the numbers of a further protocol, measured with the run or later.
        timing.json              wall-clock seconds by stage, and the machine.
        steps.jsonl              one line per decision.
        trajectory.npz           every executed pose, keyframe indices, the camera.
        decisions.npz            the best rows of every decision with scores and features; see `decisions`. Only of runs
                                 of policies.
        map.npz, map.ply         the Gaussian map; the PLY opens in any splat viewer.
        graph.npz                the Plane Scene Graph at the end; see `planes.record.graph_arrays`.
        captures/                the frames of a world, so that the run can be replayed; see `worlds.StoredCaptures`.
        pictures.npz, *.png      rendered and true views, the plan, the graph, the timeline.
        replay.html              a page that replays the run, if requested.
    logs/<job name>.log          standard error of the worker.
    .lock                        the supervisor's process; see `directory_lock`.
    summary.md, results.csv, *.png
"""

from __future__ import annotations

import os
import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive import agreement, run_files, schema
from activestructure_gym.evaluation.archive.completion import (
    DONE,
    JOBS,
    PLAYED,
    checksum_of,
    completion_markers,
    marker_and_checksums,
    write_marker,
)
from activestructure_gym.evaluation.archive.decisions import Row, rows_by_decision
from activestructure_gym.evaluation.archive.jobs import Job, policy_label, scene_label, slug
from activestructure_gym.evaluation.archive.json_files import read_json, unreadable, write_json
from activestructure_gym.evaluation.archive.temporary import refuse_links, writing
from activestructure_gym.npz import read_npz
from activestructure_gym.ranges import MAX_FRAMES

if TYPE_CHECKING:
    from activestructure_gym.mapping import GaussianMap

T = TypeVar("T")

FORMAT_VERSION = 3
CONFIG, METRICS = "config.json", "metrics.json"
COMPARISON = "compare.json"
EVALUATIONS = "evaluations"
TABLES = "tables"  # sub-directory of a comparison: the report's tables, each as Markdown, CSV and LaTeX
STEPS, TRAJECTORY, GRAPH, PICTURES, MAP = "steps.jsonl", "trajectory.npz", "graph.npz", "pictures.npz", "map.npz"
DECISIONS = "decisions.npz"  # absent from runs of references and trajectories, which compare no scores
PLY = "map.ply"
# Files with checksums. Pictures and the PLY can be made from them again and may be deleted.
_READ_AGAIN = (CONFIG, METRICS, "timing.json", STEPS, TRAJECTORY, GRAPH, PICTURES, MAP, DECISIONS)
CAPTURES = "captures"  # folder with the frames of a world; absent from runs in scenes
REPLAY = "replay.html"  # the page that replays a run; optional
_MAX_LOG_BYTES = 4096 * MAX_FRAMES  # bytes of steps.jsonl: a decision takes 1 to 3 kB and at least one frame


@dataclass(frozen=True)
class Run:
    """Hold a finished job, read from its directory. Arrays are read when they are first used.

    Parameters
    ----------
    directory
        The directory of the run.
    scene
        Short name of the scene, unique within a comparison.
    job
        The job that was run.
    config, metrics, timing
        Contents of ``config.json``, ``metrics.json`` and ``timing.json`` (seconds).
    checksums
        SHA-256 by file name, as `finish` wrote them.
    """

    directory: Path
    scene: str
    job: Job
    config: dict[str, Any]
    metrics: dict[str, Any]  # ``metrics``, ``curve``, ...
    timing: dict[str, Any]  # seconds
    checksums: Mapping[str, str] = field(default_factory=dict)

    @property
    def has_truth(self) -> bool:
        """Return whether the run was measured against ground truth; False for a run in a world without any."""
        return self.metrics["metrics"]["true_samples"] is not None

    @cached_property
    def policy(self) -> str:
        """Return the short name of the policy with the swept values; a checkpoint's name has no folders."""
        return self.job.label

    @cached_property
    def planner(self) -> str:
        """Return the short name of the policy, without swept values."""
        return policy_label(self.job.policy)

    @cached_property
    def protocols(self) -> dict[str, dict[str, Any]]:
        """Return ``parameters`` and ``metrics`` by protocol: the job's protocol first, then the further ones.

        If LPIPS was measured after the run, it is added to the metrics of the job's protocol.
        """
        own = self.job.conditions.protocol
        found = {own.name: {"parameters": own.parameters(), "metrics": self.metrics["metrics"]}}
        for content in self.evaluations.values():
            name, numbers = content["protocol"]["name"], content["metrics"]
            if name == own.name:
                numbers = _completed(self.metrics["metrics"], numbers)
            found[name] = {"parameters": content["protocol"], "metrics": numbers}
        return found

    @property
    def numbers(self) -> dict[str, Any]:
        """Return the metrics of the job's protocol, with LPIPS if it was measured after the run."""
        numbers: dict[str, Any] = self.protocols[self.job.conditions.protocol.name]["metrics"]
        return numbers

    @cached_property
    def evaluations(self) -> dict[str, dict[str, Any]]:
        """Return the contents of the JSON files in the run's ``evaluations`` folder, by file name.

        `completion.DONE` holds no checksums of these files.
        """
        found = {}
        for path in sorted((self.directory / EVALUATIONS).glob("*.json")):
            again = f"delete it, and `asg evaluate {shlex.quote(str(self.directory))} --protocols {path.stem}` measures"
            found[path.name] = read_json(path, run_files.EVALUATION, remedy=f"{again} it again")
        return found

    @cached_property
    def steps(self) -> list[dict[str, Any]]:
        """Return the log of the episode, one entry per decision."""
        return _read(self.directory, STEPS, self.checksums, _read_steps)

    @cached_property
    def trajectory(self) -> dict[str, np.ndarray]:
        """Return the executed trajectory and the camera.

        ``world_from_camera`` is [T, 4, 4] with positions in metres, ``keyframes`` [K] holds indices into it.
        ``intrinsics`` is [4] (fx, fy, cx, cy in pixels), ``image_size`` [2] (width, height).
        """
        return _read(self.directory, TRAJECTORY, self.checksums, _arrays_that(run_files.check_trajectory))

    @cached_property
    def graph(self) -> dict[str, np.ndarray] | None:
        """Return the arrays of the Plane Scene Graph, see `planes.record.graph_arrays`; None if the run has none."""
        if GRAPH not in self.checksums and not (self.directory / GRAPH).exists():
            return None
        return _read(self.directory, GRAPH, self.checksums, _arrays_that(run_files.check_graph))

    @cached_property
    def decisions(self) -> list[list[Row]] | None:
        """Return the best rows of every decision, the chosen one first; None if the run stores none."""
        if DECISIONS not in self.checksums and not (self.directory / DECISIONS).exists():
            return None
        features, steps = self.config["configuration"].get("features", ()), self.steps

        def read(path: Path) -> list[list[Row]]:
            rows = rows_by_decision(read_npz(path), features)
            agreement.check_choices(rows, steps)
            return rows

        return _read(self.directory, DECISIONS, self.checksums, read)

    @cached_property
    def pictures(self) -> dict[str, np.ndarray]:
        """Return the arrays that the pictures are drawn from; see `picture_record`."""
        return _read(self.directory, PICTURES, self.checksums, _arrays_that(run_files.check_pictures))

    @cached_property
    def gaussians(self) -> GaussianMap:
        """Return the Gaussian map."""
        from activestructure_gym.mapping import GaussianMap

        return _read(self.directory, MAP, self.checksums, GaussianMap.load_npz)


def read_done(directory: Path, job: Job, scene: str | None = None) -> Run | None:
    """Return the finished run of this job, None if there is none; raise `InputError` if it is damaged."""
    marker = marker_and_checksums(directory)[0]
    if marker != job.hash and (directory / DONE).exists():
        raise _damaged(directory / DONE, "it belongs to another job than the name of its directory")
    if not marker:
        return None
    run = read_run(directory, scene)
    if run.job.hash != job.hash:
        raise _damaged(directory / CONFIG, "it belongs to another job than the name of its directory")
    return run


def damage_of(directory: Path, job: Job) -> str | None:
    """Read every file of a finished job; return the error message of the first damaged one, None if there is none."""
    try:
        run = read_done(directory, job)
        if run is None:
            return f"'{directory}' is not a finished run: it has no {DONE} file"
        read_all(run)
    except InputError as error:
        return str(error)
    return None


def read_all(run: Run) -> None:
    """Read every file of a run; raise `InputError` if one does not match its checksum or the other files."""
    count = run.gaussians.count
    read_shown(run)
    if (recorded := run.metrics["metrics"].get("gaussians", count)) != count:
        raise _damaged(run.directory / MAP, f"it holds {count} Gaussians, and {METRICS} says {recorded}")


def read_shown(run: Run) -> None:
    """Read the files that a report shows, all except the map, and check them as `read_all` does."""
    steps, trajectory, graph, pictures = run.steps, run.trajectory, run.graph, run.pictures
    _ = run.protocols, run.decisions
    try:
        agreement.check_counts(run.metrics, run.timing["decisions"], steps, trajectory)
        agreement.check_views(run.metrics, run.job.conditions.protocol, pictures)
        if graph is not None:
            agreement.check_planes(graph, steps)
    except schema.Mismatch as error:
        raise _damaged(run.directory / METRICS, f"it does not agree with the run's other files ({error})") from error


def without_checksum(run: Run) -> list[str]:
    """Return the files without a checksum in `DONE`: changes to them cannot be detected."""
    return [name for name in _READ_AGAIN if name not in run.checksums and (run.directory / name).is_file()]


def finish(directory: Path, job: Job) -> None:
    """Write the completion marker, the last file of a run, with the checksums of the other files."""
    write_marker(directory, DONE, job, _READ_AGAIN)


def read_run(directory: str | os.PathLike[str], scene: str | None = None) -> Run:
    """Read a finished job's directory.

    Parameters
    ----------
    directory
        A directory in ``jobs/`` of a comparison.
    scene
        Short name for the scene. Default: derived from its spec.

    Returns
    -------
    Run
        Configuration, metrics and times. Arrays are read when they are first used.

    Raises
    ------
    InputError
        The run is not finished, has another format version, or is damaged.
    """
    directory = Path(directory)
    if not (directory / DONE).is_file():
        raise InputError(f"'{directory}' is not a finished run: {_why_not_a_run(directory)}")
    return open_run(directory, scene)


def open_run(directory: Path, scene: str | None = None) -> Run:
    """Read a run as `read_run` does, without requiring its completion marker."""
    marker, checksums = marker_and_checksums(directory)
    found = {}
    checks = {"config": run_files.check_config, "metrics": run_files.check_metrics, "timing": run_files.TIMING}
    for name, check in checks.items():
        # Compare the format version first: files of other versions are not checked.
        content = found[name] = _read(directory, f"{name}.json", checksums, schema.read_checked_json)
        version = content.get("format", FORMAT_VERSION) if isinstance(content, dict) else FORMAT_VERSION
        if version != FORMAT_VERSION:
            have = f"'{directory}' has the run format {version}, this version reads {FORMAT_VERSION}"
            raise InputError(f"{have}; run it again")
        _read(directory, f"{name}.json", {}, lambda path: check(content, ""))  # noqa: B023
    config = found["config"]
    if marker and config.get("hash", marker) != marker:
        raise _damaged(directory / CONFIG, f"it belongs to job {config['hash']}, and {DONE} to job {marker}")
    job = _read(directory, CONFIG, {}, lambda path: Job.from_dict(config["job"]))
    return Run(directory, scene or scene_label(job.scene), job, **found, checksums=checksums)


def without_runs(directory: Path) -> InputError:
    """Return the error for a directory that must be of a finished run, or of a comparison with one."""
    return InputError(f"'{directory}' has no finished run: {_why_not_a_run(directory)}")


def _why_not_a_run(directory: Path) -> str:
    """Return the reason why a directory is not a finished run, for an error message."""
    if not directory.exists():
        return "it does not exist"
    if not directory.is_dir():
        return "it is a file"
    if (directory / COMPARISON).is_file():
        runs = completion_markers(directory)
        example = f"; name one of its {len(runs)}, as {runs[0].parent}" if runs else ", none of whose runs has ended"
        return f"it is a comparison{example}"
    if (directory / PLAYED).is_file():
        return f"its episode was played but not measured; `asg evaluate {shlex.quote(str(directory))}` measures it"
    return f"it has no {DONE} file, which is written last"


def write_evaluation(directory: Path, parameters: dict[str, Any], scene_hash: str, metrics: dict[str, Any]) -> Path:
    """Write a protocol's metrics into a run's directory and return the file; replace a file of the same protocol.

    Raise `InputError` if the directory cannot be written.
    """
    path = directory / EVALUATIONS / f"{slug(parameters['name'])}.json"
    content = {"format": FORMAT_VERSION, "protocol": parameters, "scene": scene_hash, "metrics": metrics}
    refuse_links(directory, EVALUATIONS)
    with writing(path):
        path.parent.mkdir(exist_ok=True)
        write_json(path, content)
    return path


def _read(directory: Path, name: str, checksums: Mapping[str, str], read: Callable[[Path], T]) -> T:
    """Read a file of a run and compare it with its checksum, if it has one; raise `InputError` with a remedy."""
    path = directory / name
    try:
        if name in checksums and checksum_of(path) != checksums[name]:
            raise schema.Mismatch(f"its content does not match its checksum in {DONE}")
        return read(path)
    except (OSError, ValueError) as error:
        raise _damaged(path, error) from error


def _damaged(path: Path, reason: Exception | str) -> InputError:
    """Return the `InputError` about a damaged file of a run, with the remedy."""
    comparison = path.parent.parent.parent
    remedy = "make the run again"
    if path.parent.parent.name == JOBS and (comparison / COMPARISON).is_file():
        remedy = f"`asg compare --out {shlex.quote(str(comparison))} --resume` repeats the run"
    return unreadable(path, reason, remedy)


def _read_steps(path: Path) -> list[dict[str, Any]]:
    if path.stat().st_size > _MAX_LOG_BYTES:
        raise schema.Mismatch(f"it has more than {_MAX_LOG_BYTES:,} bytes")
    steps = []
    with open(path, "rb") as lines:
        for number, line in enumerate(lines, start=1):
            try:
                steps.append(schema.checked_json(line))
            except schema.Mismatch as error:
                raise schema.Mismatch(f"line {number}: {error}") from error
    run_files.check_steps(steps)
    return steps


def _arrays_that(pass_check: Callable[[Mapping[str, np.ndarray]], None]) -> Callable[[Path], dict[str, np.ndarray]]:
    def read(path: Path) -> dict[str, np.ndarray]:
        arrays = read_npz(path)
        pass_check(arrays)
        return arrays

    return read


def _completed(own: Mapping[str, Any], later: Mapping[str, Any]) -> dict[str, Any]:
    """Return the metrics ``own`` of a run, with the LPIPS values of ``later`` if ``own`` has none.

    All other numbers are kept, including undefined ones.
    """
    if own.get("lpips") is not None or later.get("lpips") is None or len(own["views"]) != len(later["views"]):
        return dict(own)
    return {
        **own,
        "lpips": later["lpips"],
        "lpips_weights": later.get("lpips_weights"),
        "views": [{**mine, "lpips": view.get("lpips")} for mine, view in zip(own["views"], later["views"])],
        "notes": {name: reason for name, reason in (own.get("notes") or {}).items() if name != "lpips"},
    }
