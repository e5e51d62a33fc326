"""Store episodes that were played but not measured yet. Each is in the directory of its later run.

In addition to the files of a run (`store`), such a directory holds::

    .played          the job's hash, then the SHA-256 of every file that measuring reads, and of decisions.npz, as
                     sha256sum prints it.
    episode.json     the curve, the times, and the counts of the episode.
    plan.npz         the volume's plan and the map from above; see `picture_record.plan_arrays`.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive import completion, json_files, run_files, schema, store
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.archive.native_settings_diff import changed_native_settings
from activestructure_gym.evaluation.archive.plugin_code import changed_code
from activestructure_gym.npz import read_npz

EPISODE, PLAN = "episode.json", "plan.npz"
_READ = (store.CONFIG, store.STEPS, store.TRAJECTORY, store.GRAPH, store.MAP, EPISODE, PLAN)

_CHECK: schema.Check = schema.table(
    {
        "metrics": schema.table(others=schema.scalar), "frame_budget": schema.number(1, whole=True),
        "curve": run_files.CURVE,
        "clock": schema.table({
            "total": schema.number(0), "evaluation": schema.number(0), "seconds": schema.table(others=schema.number(0)),
            "decisions": schema.each(schema.number(0)), "hardware": schema.table(others=schema.scalar),
        }),
    }
)  # fmt: skip


@contextmanager
def written_episode(directory: Path, job: Job) -> Iterator[Path]:
    """Yield a temporary folder for a played episode; it replaces the run's directory when the block ends."""
    with completion.atomic_directory(directory) as part:
        yield part
        completion.write_marker(part, completion.PLAYED, job, (*_READ, store.DECISIONS))


def played_episode(
    directory: Path, job: Job | None = None, checksums: Callable[[str], str | None] | None = None
) -> Path | None:
    """Return the directory of an undamaged played episode, None if there is none.

    If ``job`` is given, the episode must be of this job. If ``checksums`` is given too, the job's plug-in code and
    native settings must be unchanged.
    """
    for place in (directory, completion.aside_of(directory)):
        marker, digests = completion.marker_and_checksums(place, completion.PLAYED)
        if not marker or (job is not None and marker != job.hash) or set(digests) - {store.DECISIONS} != set(_READ):
            continue
        with suppress(InputError, OSError, ValueError):
            if any(completion.checksum_of(place / name) != digest for name, digest in digests.items()):
                continue
            if job is not None and checksums is not None:
                if changed_code(place, job, checksums) or changed_native_settings(place, job):
                    continue
            return place
    return None


def is_played(directory: Path) -> bool:
    """Return whether a run's directory holds a played episode and no finished run."""
    places = (directory, completion.aside_of(directory))
    return not (directory / completion.DONE).exists() and any((place / completion.PLAYED).is_file() for place in places)


def job_of(place: Path) -> Job:
    """Return the job of a played episode."""
    config = json_files.read_json(place / store.CONFIG, run_files.check_config)
    return Job.from_dict(config["job"])


def read_episode(place: Path) -> dict[str, Any]:
    """Return the content of `EPISODE`."""
    content: dict[str, Any] = json_files.read_json(place / EPISODE, _CHECK)
    return content


def read_plan(place: Path) -> dict[str, np.ndarray]:
    """Return the arrays of `PLAN`."""
    return _arrays(place / PLAN, run_files.check_plan)


def read_path(place: Path) -> dict[str, np.ndarray]:
    """Return the arrays of `store.TRAJECTORY`."""
    return _arrays(place / store.TRAJECTORY, run_files.check_trajectory)


def _arrays(file: Path, check: Callable[[dict[str, np.ndarray]], None]) -> dict[str, np.ndarray]:
    try:
        arrays = read_npz(file)
        check(arrays)
    except (OSError, ValueError) as error:
        raise damaged(file, error) from error
    return arrays


def damaged(file: Path, reason: Exception) -> InputError:
    """Return the `InputError` about a damaged file of a played episode."""
    return InputError(f"'{file}' is damaged: {reason}; delete '{file.parent}', and its episode is played again")


def link_files(place: Path, part: Path) -> None:
    """Hard-link the files of a played episode that its run keeps into ``part``, a folder of the same file system.

    All other files of the run are written later. Copying links to them from ``place`` would let a write follow them.
    """
    if (place / store.CAPTURES).is_dir():
        link_folder(place / store.CAPTURES, part / store.CAPTURES)
    for name in (store.CONFIG, store.TRAJECTORY, store.GRAPH, store.MAP, store.PLY, store.DECISIONS):
        if (place / name).is_file():
            _link(place / name, part / name)


def link_folder(folder: Path, target: Path) -> None:
    """Hard-link the files of a folder into ``target``, which is made."""
    target.mkdir(exist_ok=True)
    for file in sorted(folder.iterdir()):
        if file.is_file() and not file.name.startswith("."):  # no temporary files
            _link(file, target / file.name)


def _link(file: Path, target: Path) -> None:
    try:
        if file.is_symlink():
            raise OSError("a symbolic link is copied")
        os.link(file, target)
    except OSError:  # also on a file system without hard links
        shutil.copy2(file, target)
