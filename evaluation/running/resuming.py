"""Resume a comparison: read its record, check its finished runs, and add further jobs.

All jobs of a comparison share the conditions (preset, budget, overrides, start, protocols), the swept fields in
their order, the content of every scene and the version of this package. Jobs can be added, never removed.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from activestructure_gym._version import __version__
from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive import completion, json_files, plugin_code, store
from activestructure_gym.evaluation.archive.comparison import jobs_of, read_record, run_directory
from activestructure_gym.evaluation.archive.jobs import Job, one_spec_each, policy_label
from activestructure_gym.evaluation.archive.native_settings_diff import changed_native_settings


def recorded_jobs(directory: Path) -> list[Job]:
    """Return the jobs in the record of the comparison in ``directory``; an empty list if it has no record.

    Raise `InputError` if another version of this package wrote the record.
    """
    record = read_record(directory)
    if record is None:
        return []
    jobs = jobs_of(record, directory)
    if [job.name for job in jobs] != list(record["jobs"]):
        versions = record.get("versions") or {}
        raise InputError(
            f"'{directory}' was begun with version {versions.get('activestructure-gym', 'unknown')} of "
            f"activestructure-gym, this is {__version__}: results are not mixed, begin a new comparison"
        )
    return jobs


def review_finished(
    jobs: Iterable[Job], asked: Collection[str], directory: Path, notify: Callable[[str], None]
) -> None:
    """Mark damaged runs as not finished, and withdraw runs of ``asked`` jobs that were played with other code.

    Other code means changed plug-in code or, in the native setup, changed native settings of the policy. ``asked``
    holds the names of jobs. A withdrawn run is reinstated if its code is unchanged again. ``notify`` is called with a
    message for each damaged run, and one for all runs with the same changed code.
    """
    checksums = cache(plugin_code.checksum_of)
    again, kept = Counter[str](), Counter[str]()
    for job in jobs:
        place = run_directory(directory, job)
        if completion.is_withdrawn(place) and _is_unchanged(place, job, checksums):
            completion.reinstate(place)
        if not completion.is_done(place, job):
            continue
        if damage := store.damage_of(place, job):
            completion.set_aside(place)
            notify(f"{job.title} counts as not finished: {damage}")
        elif changed := [*plugin_code.changed_code(place, job, checksums), *_changed_settings(place, job)]:
            if job.name in asked:
                completion.withdraw(place)
            (again if job.name in asked else kept)[" and ".join(changed)] += 1
    for names, count in again.items():
        notify(f"{_runs(count, names)} {'is' if count == 1 else 'are'} played again: its code has changed since")
    for names, count in kept.items():
        notify(f"{_runs(count, names)} {'stays' if count == 1 else 'stay'}, though its code has changed since")


def _is_unchanged(place: Path, job: Job, checksums: Callable[[str], str | None]) -> bool:
    """Return whether the code that a withdrawn run was played with is the current code."""
    if plugin_code.plugin_code_of(job, checksums):
        return plugin_code.is_unchanged(place, job, checksums)
    return job.conditions.setup == "native" and not changed_native_settings(place, job)


def _changed_settings(place: Path, job: Job) -> list[str]:
    fields = changed_native_settings(place, job)
    return [f"the native settings of {policy_label(job.policy)} ({', '.join(fields)})"] if fields else []


def _runs(count: int, own: str) -> str:
    return f"{count} run{'' if count == 1 else 's'} with {own}"


def merged(recorded: Sequence[Job], asked: Sequence[Job], directory: Path) -> list[Job]:
    """Return the recorded jobs and the new ones; raise `InputError` if they cannot be in one comparison.

    A scene that is asked for under a new path gets this path in all jobs.
    """
    if recorded and asked:
        _check_conditions(recorded[0], asked[0], directory)
        hashes = {job.scene: job.scene_hash for job in recorded}
        for job in asked:
            if hashes.get(job.scene, job.scene_hash) != job.scene_hash:
                raise InputError(
                    f"scene '{job.scene}' has changed since '{directory}' was begun: begin a new comparison"
                )
    return list({job.name: job for job in one_spec_each((*recorded, *asked))}.values())


def _check_conditions(before: Job, asked: Job, directory: Path) -> None:
    old, new = (
        _flat(json_files.as_read(
            {"setup": one.conditions.setup, "sweep": ", ".join(one.swept) or None}
            | one.shared_conditions.as_dict()
        ))
        for one in (before, asked)
    )  # fmt: skip
    different = [
        f"{name} was {_words(old.get(name))}, asked for is {_words(new.get(name))}"
        for name in dict.fromkeys((*old, *new))
        if old.get(name) != new.get(name)
    ]
    if not different:
        return
    raise InputError(
        f"'{directory}' was begun under other conditions ({'; '.join(different)}): give --out and --resume alone to go "
        "on with it, or choose another --out"
    )


def _flat(content: Mapping[str, Any]) -> dict[str, Any]:
    """Return a nested table as one level, with names joined by dots."""
    flat: dict[str, Any] = {}
    for name, value in content.items():
        if isinstance(value, dict):
            flat |= {f"{name}.{inner}": entry for inner, entry in _flat(value).items()}
        else:
            flat[name] = value
    return flat


def _words(value: Any) -> str:
    if value is None:
        return "not given"
    if isinstance(value, list) and all(isinstance(entry, dict) for entry in value):  # protocols
        return ", ".join(str(entry.get("name", entry)) for entry in value) or "none"
    return value if isinstance(value, str) else json.dumps(value)
