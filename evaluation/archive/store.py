"""Run directories: written once, whole or not at all, and readable without us (JSON, JSON lines, npz, PLY).

A comparison's directory::

    compare.json                 the grid: jobs, command, versions, machine
    jobs/<job name>/             one per finished job
        .done                    the job's hash; what has no such file is not a result
        config.json              job, protocol, resolved configuration, scene, versions
        metrics.json             the numbers and the convergence curve; no clock in it
        evaluations/NAME.json    the numbers of a further protocol, measured with the run or later
        timing.json              wall-clock seconds by stage, and the machine
        steps.jsonl              one line per decision
        trajectory.npz           every executed pose, keyframe indices, the camera
        map.npz, map.ply         the Gaussian map; the PLY opens in any splat viewer
        graph.npz                the Plane Scene Graph at the end; see `plane_record.graph_arrays`
        pictures.npz, *.png      rendered and true views, the plan, the graph, the timeline
    logs/<job name>.log          what a worker wrote to its standard error
    .lock                        who is at work here; see `directory_lock`
    summary.md, results.csv, *.png
"""

from __future__ import annotations

import json
import math
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive.jobs import Job, policy_label, scene_label
from activestructure_gym.evaluation.machine.processes import is_alive, machine_mark
from activestructure_gym.files import replaced

FORMAT_VERSION = 2
DONE = ".done"
CONFIG = "config.json"
COMPARISON = "compare.json"
EVALUATIONS = "evaluations"


@dataclass(frozen=True)
class Run:
    """A finished job, read from its directory."""

    directory: Path  # where it was read from
    scene: str  # what people call it; differs between the scenes of a comparison
    job: Job  # what was run
    config: dict[str, Any]  # of config.json
    metrics: dict[str, Any]  # of metrics.json: ``metrics``, ``curve``, ...
    timing: dict[str, Any]  # of timing.json, seconds

    @cached_property
    def policy(self) -> str:
        """What people call the policy: a checkpoint without the folders it lies in."""
        return policy_label(self.job.policy)

    @cached_property
    def protocols(self) -> dict[str, dict[str, Any]]:
        """``parameters`` and ``metrics`` by protocol: the run's own first, then those measured on top of it.

        The run's own numbers are `metrics`, completed by an LPIPS that was measured later.
        """
        own = self.job.protocol
        found = {own.name: {"parameters": own.parameters(), "metrics": self.metrics["metrics"]}}
        for path in sorted((self.directory / EVALUATIONS).glob("*.json")):
            content = read_json(path)
            name, numbers = content["protocol"]["name"], content["metrics"]
            if name == own.name:
                numbers = {**numbers, **{k: v for k, v in self.metrics["metrics"].items() if v is not None}}
            found[name] = {"parameters": content["protocol"], "metrics": numbers}
        return found

    @cached_property
    def steps(self) -> list[dict[str, Any]]:
        """One entry per decision."""
        with open(self.directory / "steps.jsonl", encoding="utf-8") as lines:
            return [json.loads(line) for line in lines]

    @cached_property
    def trajectory(self) -> dict[str, np.ndarray]:
        """``world_from_camera`` [T, 4, 4], ``keyframes`` [K] indices into it; the camera: ``intrinsics`` [4] (fx, fy,
        cx, cy in pixels) and ``image_size`` [2] (width, height)."""
        return load_arrays(self.directory / "trajectory.npz")

    @cached_property
    def graph(self) -> dict[str, np.ndarray] | None:
        """The Plane Scene Graph, see `plane_record.graph_arrays`; None if the run kept none."""
        path = self.directory / "graph.npz"
        return load_arrays(path) if path.is_file() else None

    @cached_property
    def pictures(self) -> dict[str, np.ndarray]:
        """What the pictures were drawn from; see `picture_record.picture_arrays`."""
        return load_arrays(self.directory / "pictures.npz")


def is_done(directory: Path, job: Job) -> bool:
    """Whether ``directory`` holds the finished result of exactly this job."""
    try:
        return (directory / DONE).read_text(encoding="utf-8").strip() == job.hash
    except OSError:
        return False


def read_run(directory: Path, scene: str | None = None) -> Run:
    """Open a finished job's directory.

    Parameters
    ----------
    directory
        One of ``jobs/`` of a comparison.
    scene
        Another short name for the scene; by its spec if not given.

    Returns
    -------
    Run
        Configuration, numbers and clocks; arrays are read when they are asked for.

    Raises
    ------
    InputError
        It is not finished, of another format, or damaged.
    """
    if not (directory / DONE).is_file():
        raise InputError(f"'{directory}' is not a finished run: it has no {DONE} file")
    return open_run(directory, scene)


def open_run(directory: Path, scene: str | None = None) -> Run:
    """The same for a directory whose data are whole and which may not count as finished yet."""
    try:
        content = {name: read_json(directory / f"{name}.json") for name in ("config", "metrics", "timing")}
        if content["config"]["format"] != FORMAT_VERSION:
            raise InputError(
                f"'{directory}' has the run format {content['config']['format']}, this version reads {FORMAT_VERSION}; "
                "run it again"
            )
        job = Job.from_dict(content["config"]["job"])
        return Run(directory, scene or scene_label(job.scene), job, **content)
    except (OSError, KeyError, TypeError, json.JSONDecodeError) as error:
        raise InputError(f"'{directory}' cannot be read as a run ({type(error).__name__}: {error})") from error


@contextmanager
def whole_directory(directory: Path) -> Iterator[Path]:
    """A temporary sibling to write into; it takes the name ``directory`` when the block ends without an error.

    Whatever stood there before is replaced, unless it is the same job's finished result: another process was faster,
    and equal jobs give equal results. The content is on the disk before the name is. After an error, Ctrl-C included,
    nothing is left behind.
    """
    directory.parent.mkdir(parents=True, exist_ok=True)
    part = directory.with_name(f".{directory.name}.part-{machine_mark()}-{os.getpid()}")
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir()
    try:
        yield part
        if _same_result(part, directory):
            return
        _flush(part)
        if directory.exists():
            shutil.rmtree(directory)
        try:
            os.replace(part, directory)
        except OSError:
            if not _same_result(part, directory):
                raise
    finally:
        shutil.rmtree(part, ignore_errors=True)


def write_evaluation(directory: Path, parameters: dict[str, Any], scene_hash: str, metrics: dict[str, Any]) -> Path:
    """Keep a further protocol's numbers in a run's directory; replaces those of the same protocol."""
    path = directory / EVALUATIONS / f"{parameters['name']}.json"
    path.parent.mkdir(exist_ok=True)
    content = {"format": FORMAT_VERSION, "protocol": parameters, "scene": scene_hash, "metrics": metrics}
    write_json(path, content)
    return path


def remove_parts(directory: Path, job_name: str | None = None) -> None:
    """Remove what killed processes left half-written in ``directory``, of one job or of all.

    What a living process of this machine writes is left alone.
    """
    pattern = f".{job_name or '*'}.part-*"
    for part in directory.glob(pattern):
        machine, _, process = part.name.rpartition(".part-")[2].partition("-")
        if not (machine == machine_mark() and process.isdigit() and is_alive(int(process))):
            shutil.rmtree(part, ignore_errors=True)


def write_json(path: Path, content: Any) -> None:
    """Write ``content`` at once: readers see the old file or the new one."""
    text = json.dumps(plain(content), indent=1, allow_nan=False) + "\n"
    with replaced(path) as file:
        file.write(text.encode("utf-8"))


def read_json(path: Path) -> Any:
    """The content of a JSON file."""
    return json.loads(path.read_text(encoding="utf-8"))


def load_arrays(path: Path) -> dict[str, np.ndarray]:
    """All arrays of an npz file; never unpickles."""
    with np.load(path, allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def json_line(content: Any) -> str:
    """One line of a JSON lines file."""
    return json.dumps(plain(content), allow_nan=False, separators=(",", ":")) + "\n"


def plain(value: Any) -> Any:
    """The same content in JSON's types. JSON has no NaN and no infinity: they become null."""
    if isinstance(value, dict):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    raise TypeError(f"{type(value).__name__} cannot be written as JSON")


def _same_result(one: Path, other: Path) -> bool:
    """Whether both directories are finished results of the same job."""
    try:
        return (one / DONE).read_bytes() == (other / DONE).read_bytes()
    except OSError:
        return False


def _flush(directory: Path) -> None:
    """Have all files of ``directory`` written to the disk: what has a name survives a power cut too."""
    if os.name != "posix":
        return
    for path in (*directory.rglob("*"), directory):
        descriptor = os.open(path, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        except OSError:
            pass  # a file system that cannot promise it
        finally:
            os.close(descriptor)
