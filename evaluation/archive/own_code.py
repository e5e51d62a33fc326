"""Which code outside of this package a run was played by: somebody's own policy, features and candidate sources.

It changes while it is written. A run keeps the sums of the modules that its job names, so that one which an older text
played is known when a comparison is gone on with. What these import from elsewhere is not followed, and a scene needs
no sum: a job names it by its content.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive import store
from activestructure_gym.evaluation.archive.jobs import Job, named_in

KEY = "own_code"  # in a run's `store.CONFIG`, where there is any
_SKIPPED = ("__pycache__", "site-packages", "node_modules")  # folders, and those that begin with a dot


def sum_of(module: str) -> str | None:
    """SHA-256 of a module's file, in a package that of all its Python files with their names; imports nothing.

    ``module`` is the outermost name. None where there is no such file, or one that cannot be read.
    """
    total = hashlib.sha256()
    try:
        files = list(_files_of(module))
        for name, file in files:
            total.update(name.encode(errors="surrogateescape") + b"\0" + file.read_bytes() + b"\0")
    except (ImportError, OSError, ValueError):
        return None
    return total.hexdigest() if files else None


first_sum_of = cache(sum_of)  # what this process has imported stays as it was then


def own_code(job: Job, sums: Callable[[str], str | None]) -> dict[str, str]:
    """Sums of the own code that a job names, by what it is ("policy mine:Mine"); what is not found is left out."""
    found = {}
    for registry, name in named_in(job):
        module = registry.module_of(name.partition("?")[0])
        total = None if module is None else sums(module.partition(".")[0])
        if total is not None:
            found[f"{registry.kind} {name}"] = total
    return found


def changed_code(directory: Path, job: Job, sums: Callable[[str], str | None]) -> list[str]:
    """What of a run's own code is not as it was then ("policy mine:Mine"); a sum that is missing counts as equal."""
    now = own_code(job, sums)
    if not now:
        return []
    try:
        then = store.read_json(directory / store.CONFIG).get(KEY) or {}
    except InputError:
        return list(now)
    return [name for name, total in now.items() if then.get(name, total) != total]


def _files_of(module: str) -> Iterator[tuple[str, Path]]:
    """Name within the module and place of every file, by name; the first of those that have one name."""
    spec = importlib.util.find_spec(module)
    if spec is None:
        return
    if spec.submodule_search_locations is None:
        if spec.origin is not None and Path(spec.origin).is_file():
            yield "", Path(spec.origin)
        return
    found = dict[str, Path]()
    for root in map(Path, spec.submodule_search_locations):
        for folder, below, files in os.walk(root):
            below[:] = [name for name in below if not name.startswith(".") and name not in _SKIPPED]
            for file in (Path(folder) / name for name in files if name.endswith(".py")):
                found.setdefault(file.relative_to(root).as_posix(), file)
    yield from sorted(found.items())
