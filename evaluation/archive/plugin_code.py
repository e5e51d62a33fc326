"""Checksums of plug-in code: policies, features and candidate sources outside of this package.

A run keeps the checksums of the modules that its job names. A resumed comparison finds by them the runs that an older
version of the code played. Imports of these modules are not followed. A scene needs no checksum: a job names it by its
content.
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
from activestructure_gym.specs import Spec

KEY = "own_code"  # in a run's `store.CONFIG`, where there is any
_CHECK = schema.table({}, {KEY: schema.table(others=schema.text)}, others=schema.anything)
_SKIPPED = ("__pycache__", "node_modules")  # folders, and all that no import statement can name
_RUNS = "compare.json"  # a folder that holds it is a comparison's


def checksum_of(module: str) -> str | None:
    """Return the SHA-256 of a module's file, or of all Python files of a package and their names. Imports nothing.

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


first_checksum_of = cache(checksum_of)  # called before a module is imported: the content that this process runs


def plugin_code_of(job: Job, checksums: Callable[[str], str | None]) -> dict[str, str]:
    """Return the checksums of the plug-in code that a job names ("policy mine:Mine"); missing modules are left out."""
    found = {}
    for registry, name in named_in(job):
        module = registry.module_of(Spec.of(name).name)
        total = None if module is None else checksums(module.partition(".")[0])
        if total is not None:
            found[f"{registry.kind} {name}"] = total
    return found


def changed_code(directory: Path, job: Job, checksums: Callable[[str], str | None]) -> list[str]:
    """Return the plug-in code of a run that has changed ("policy mine:Mine"). A missing checksum counts as equal."""
    now = plugin_code_of(job, checksums)
    if not now:
        return []
    then = _checksums_then(directory)
    return list(now) if then is None else [name for name, total in now.items() if then.get(name, total) != total]


def is_unchanged(directory: Path, job: Job, checksums: Callable[[str], str | None]) -> bool:
    """Check that all plug-in code with a checksum in the run exists and is unchanged."""
    then = _checksums_then(directory)
    return bool(then) and then == plugin_code_of(job, checksums)


def _checksums_then(directory: Path) -> dict[str, str] | None:
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
