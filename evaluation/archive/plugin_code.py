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
from activestructure_gym.evaluation.archive import schema, store
from activestructure_gym.evaluation.archive.jobs import Job, named_in

KEY = "own_code"  # in a run's `store.CONFIG`, where there is any
_CHECK = schema.table({}, {KEY: schema.table(others=schema.text)}, others=schema.anything)
_SKIPPED = ("__pycache__", "node_modules")  # folders, and all that no import statement can name
_RUNS = "compare.json"  # a folder that holds it is a comparison's


def sum_of(module: str) -> str | None:
    """SHA-256 of a module's file, in a package that of all its Python files with their names; imports nothing.

    ``module`` is the outermost name. None where there is no such file.
    """
    total = hashlib.sha256()
    try:
        files = list(_files_of(module))
    except (ImportError, OSError, ValueError):
        return None
    for name, file in files:
        try:
            content = file.read_bytes()
        except OSError as error:  # it counts all the same, or nothing in its package would
            content = type(error).__name__.encode()
        total.update(os.fsencode(name) + b"\0" + content + b"\0")
    return total.hexdigest() if files else None


first_sum_of = cache(sum_of)  # for what this process imports, asked before it does: that stays as it was then


def plugin_code_of(job: Job, sums: Callable[[str], str | None]) -> dict[str, str]:
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
    now = plugin_code_of(job, sums)
    if not now:
        return []
    then = _sums_then(directory)
    return list(now) if then is None else [name for name, total in now.items() if then.get(name, total) != total]


def is_as_it_was(directory: Path, job: Job, sums: Callable[[str], str | None]) -> bool:
    """Whether all own code that a run has sums of is there and is what played it."""
    then = _sums_then(directory)
    return bool(then) and then == plugin_code_of(job, sums)


def _sums_then(directory: Path) -> dict[str, str] | None:
    try:
        return dict(store.read_json(directory / store.CONFIG, _CHECK).get(KEY, {}))
    except InputError:
        return None


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
            below[:] = [name for name in below if name.isidentifier() and name not in _SKIPPED]
            if _RUNS in files:
                below.clear()
                continue
            for file in (Path(folder) / name for name in files if name.endswith(".py") and name[0] != "."):
                found.setdefault(file.relative_to(root).as_posix(), file)
    yield from sorted(found.items())
