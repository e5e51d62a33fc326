"""Read a comparison's directory: its record, the directories of its runs, and the finished runs."""

from __future__ import annotations

import copy
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive import completion, json_files, run_files, store
from activestructure_gym.evaluation.archive.jobs import Job, one_spec_each, scene_labels
from activestructure_gym.evaluation.archive.store import Run

_REMEDY = (
    "move it away and give scenes, policies and options again, with the same --out and --resume: finished runs are kept"
)


def run_directory(directory: Path, job: Job) -> Path:
    """Return the directory of a job's run within a comparison's directory."""
    return directory / completion.JOBS / job.name


def read_record(directory: Path) -> dict[str, Any] | None:
    """Return the content of ``compare.json``, None if the file does not exist; raise `InputError` if it is damaged."""
    file = directory / store.COMPARISON
    if not file.exists():
        return None
    record: dict[str, Any] = json_files.read_json(file, run_files.COMPARISON, remedy=_REMEDY)
    return record


def jobs_of(record: Mapping[str, Any], directory: Path) -> list[Job]:
    """Return the jobs of a record, with one spec per scene; raise `InputError` if they cannot be read."""
    try:
        return one_spec_each([Job.from_dict(content) for content in record["jobs"].values()])
    except InputError as error:
        raise InputError(f"'{directory / store.COMPARISON}' cannot be read: {error}") from error


def finished_runs(directory: Path, jobs: Sequence[Job]) -> list[Run]:
    """Return the finished runs of these jobs, in the order of the jobs."""
    labels = scene_labels({job.scene: job.scene_hash for job in jobs})
    found = [store.read_done(run_directory(directory, job), job, labels[job.scene]) for job in jobs]
    return [run for run in found if run is not None]


def readable_runs(directory: Path, jobs: Sequence[Job]) -> tuple[list[Run], dict[str, str]]:
    """Return the finished runs that a report can read, and the damage of the others by the name of their job."""
    labels = scene_labels({job.scene: job.scene_hash for job in jobs})
    found, damaged = list[Run](), dict[str, str]()
    for job in jobs:
        try:
            run = store.read_done(run_directory(directory, job), job, labels[job.scene])
            if run is not None:
                store.read_shown(copy.copy(run))  # a copy, so that the arrays it caches are freed
                found.append(run)
        except InputError as error:
            damaged[job.name] = str(error)
    return found, damaged


def verified_runs(directories: Sequence[Path]) -> tuple[list[Run], dict[str, str]]:
    """Return the runs in directories of comparisons or runs, and the error of each unreadable run by its directory.

    Every file of a run is compared with its checksum. Raise `InputError` for a directory without a finished run.
    """
    runs, refused = list[Run](), dict[str, str]()
    for directory in directories:
        markers = completion.completion_markers(directory)
        if not markers and not (directory / completion.DONE).is_file():
            raise store.without_runs(directory)
        for place in [marker.parent for marker in markers] or [directory]:
            try:
                run = store.read_run(place)
                store.read_all(run)
                runs.append(run)
            except InputError as error:
                refused[str(place)] = str(error)
    labels = scene_labels({run.job.scene: run.job.scene_hash for run in runs})
    return [replace(run, scene=labels[run.job.scene]) for run in runs], refused


def open_comparison(directory: str | os.PathLike[str]) -> list[Run]:
    """Return all finished runs of a comparison's directory.

    Parameters
    ----------
    directory
        The output directory of ``asg compare --out`` or `compare`, or a copy of it.

    Returns
    -------
    list of Run
        The runs in the order of the comparison's record: by seed, then scene, then policy.

    Raises
    ------
    InputError
        The record or a run cannot be read.
    """
    directory = Path(directory)
    record = read_record(directory)
    if record is None:
        raise InputError(f"'{directory}' cannot be read as a comparison: it has no {store.COMPARISON}")
    return finished_runs(directory, jobs_of(record, directory))
