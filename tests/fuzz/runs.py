"""Comparisons and runs: every file damaged or made by an enemy; report, resume, evaluate and export.

What is refused leaves nothing half-written. A damaged run is made again by ``--resume``. No name in a file is imported.
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.fuzz._archives import asg, comparison, content_of, damage, evil_module, in_folder, runs_of, seal, write

CI_CASES = 10

_COMMANDS = (
    "report", "report in place", "resume", "evaluate", "evaluate one", "export", "replay", "score",
)  # fmt: skip


def case(rng: np.random.Generator, folder: Path) -> Callable[[], object]:
    """A comparison in ``folder/all`` with some damage, and the command that reads it."""
    files = dict(comparison())
    evil, mark = evil_module(folder, rng)
    command = str(rng.choice(_COMMANDS))
    run = str(rng.choice(runs_of(files)))
    if rng.random() < 0.12:
        damaged = [_name_code(rng, files, run, evil)]
    else:
        # Of two files of one run at most: mostly those that are read.
        own = [name for name in files if name.startswith(run) and not name.endswith(".ply")]
        own += [f"{run}/evaluations/activegamer.json", "compare.json", "compare.json"]
        damaged = sorted({str(name) for name in rng.choice(own, int(rng.integers(1, 3)))})
        for name in damaged:
            before = files.get(name, comparison()[f"{run}/metrics.json"])
            after = damage(rng, name, before, files)
            files.pop(name, None)
            if after is not None:
                files[name] = after
            elif rng.random() < 0.1:
                files[f"{name}/file"] = b""  # a folder in its place
    if rng.random() < 0.4:  # what is drawn is drawn again
        files = {name: content for name, content in files.items() if not name.endswith(".png")}
    if rng.random() < 0.7 and f"{run}/.done" in files:
        seal(files, run)
    write(files, folder / "all")
    (folder / "command.json").write_text(json.dumps([command, run, damaged]))
    return lambda: _check(folder, command, run, damaged, mark)


def _name_code(rng: np.random.Generator, files: dict[str, bytes], run: str, evil: str) -> str:
    """A record or a run that names a module, as a scene, a policy or a gain."""
    name = str(rng.choice(["compare.json", f"{run}/config.json"]))
    content = json.loads(files[name])
    jobs = list(content["jobs"].values()) if name == "compare.json" else [content["job"]]
    for job in jobs:
        kind = rng.integers(3)
        if kind == 0:
            job["scene"] = f"{evil}:make"
        elif kind == 1:
            job["policy"] = f"{evil}:make"
        else:
            job["overrides"]["features"] = [f"{evil}:make"]
    if name == "compare.json":  # names go with contents
        from activestructure_gym.evaluation.archive.jobs import Job

        content["jobs"] = {Job.from_dict(job).name: job for job in jobs}
        for old, new in zip(runs_of(files), content["jobs"]):
            for file in [file for file in files if file.startswith(f"{old}/")]:
                files[file.replace(old, f"jobs/{new}")] = files.pop(file)
    files[name] = json.dumps(content).encode()
    return name


def _check(folder: Path, command: str, run: str, damaged: list[str], mark: Path) -> None:
    from activestructure_gym.errors import InputError

    in_folder(folder)
    before = content_of(folder)
    try:
        if command == "resume":
            _resume(run, damaged)
        elif command.startswith("report"):
            _report(folder / ("report" if command == "report" else "all"))
        elif command.startswith("evaluate"):
            asg("evaluate", f"all/{run}" if command == "evaluate one" else "all")
        elif command == "replay":
            asg("replay", f"all/{run}", "--out", "replay.html")
        elif command == "score":
            _score(run)
        else:
            asg("export", f"all/{run}", "--out", "map.ply")
    except InputError:
        if command != "resume" and content_of(folder) != before:
            raise AssertionError("a refused command has left something behind") from None
        raise
    finally:
        if mark.exists():
            raise AssertionError("code that a file names was run")


def _score(run: str) -> None:
    """Follow the run's path, as far as it is checked; the run that would be made of it is not."""
    from activestructure_gym.evaluation.references.trajectory import TrajectorySpec
    from activestructure_gym.specs import Spec

    given = TrajectorySpec.of(Spec(f"trajectory:all/{run}/trajectory.npz"))
    _ = given.spec, given.frames


def _report(out: Path) -> None:
    asg("report", "all", "--out", str(out))
    if not (out / "report.html").is_file() or list(out.glob(".*.part-*")):
        raise AssertionError("a report without its page, or with what it was made in")


def _resume(run: str, damaged: list[str]) -> None:
    """All that is damaged is made again, unless the record itself is."""
    from activestructure_gym.evaluation.archive.comparison import open_comparison

    code = asg("compare", "--out", "all", "--resume", "--engine", "inline")
    runs = open_comparison(Path("all"))
    finished = {f"jobs/{one.directory.name}" for one in runs}
    if code == 0 and "compare.json" not in damaged and (run not in finished or len(finished) != 2):
        raise AssertionError(f"{shlex.join(damaged)} was damaged, and its run was not made again")
    for one in runs:
        _ = one.steps, one.trajectory, one.graph, one.pictures, one.gaussians
