"""Compute checksums of plug-in code: policies, features, candidate sources and mappers outside of this package.

A run stores the checksums of the modules that its job and its configuration name. A resumed comparison uses them to
find runs that were played with older code. Modules that these modules import are not included. A scene needs no
checksum: a job holds the hash of its content.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive import json_files, schema, store
from activestructure_gym.evaluation.archive.jobs import Job, named_in, named_in_overrides

KEY = "own_code"  # entry of a run's `store.CONFIG`; absent without plug-in code
_CHECK = schema.table(
    {}, {KEY: schema.table(others=schema.text), "configuration": schema.table()}, others=schema.anything
)
_SKIPPED = ("__pycache__", "node_modules")  # folders
_RUNS = "compare.json"  # marks a comparison's folder, which is skipped


def checksum_of(module: str) -> str | None:
    """Return the SHA-256 of a module's file, or of the names and contents of all Python files of a package.

    ``module`` is the top-level name; it is not imported. Return None if it has no file.
    """
    total = hashlib.sha256()
    try:
        files = list(_files_of(module))
    except (ImportError, OSError, ValueError):
        return None
    for name, file in files:
        try:
            content = file.read_bytes()
        except OSError as error:  # an unreadable file must not leave its package without a checksum
            content = type(error).__name__.encode()
        total.update(os.fsencode(name) + b"\0" + content + b"\0")
    return total.hexdigest() if files else None


first_checksum_of = cache(checksum_of)  # call it before the import: it keeps the checksum of the code that runs here


def plugin_code_of(
    job: Job, checksums: Callable[[str], str | None], configuration: Mapping[str, Any] | None = None
) -> dict[str, str]:
    """Return the checksums of a job's plug-in code by kind and name ("policy mine:Mine"), without missing modules.

    With the ``configuration`` of its environment, the features and native settings of its policy are included.
    """
    found = {}
    for registry, name in (*named_in(job), *named_in_overrides(configuration or {})):
        module = registry.module_of(name.name)
        total = None if module is None else checksums(module.partition(".")[0])
        if total is not None:
            found[f"{registry.kind} {name}"] = total
    return found


def changed_code(directory: Path, job: Job, checksums: Callable[[str], str | None]) -> list[str]:
    """Return the changed plug-in code of a run ("policy mine:Mine"). A missing checksum counts as equal."""
    then, configuration = _stored(directory)
    now = plugin_code_of(job, checksums, configuration)
    return list(now) if then is None else [name for name, total in now.items() if then.get(name, total) != total]


def is_unchanged(directory: Path, job: Job, checksums: Callable[[str], str | None]) -> bool:
    """Return whether the run has checksums of plug-in code, and all of this code is unchanged."""
    then, configuration = _stored(directory)
    return bool(then) and then == plugin_code_of(job, checksums, configuration)


def _stored(directory: Path) -> tuple[dict[str, str] | None, dict[str, Any]]:
    """Return the checksums and the configuration of a run; None and {} if they cannot be read."""
    try:
        content = json_files.read_json(directory / store.CONFIG, _CHECK)
    except InputError:
        return None, {}
    return dict(content.get(KEY, {})), content.get("configuration", {})


def _files_of(module: str) -> Iterator[tuple[str, Path]]:
    """Yield the name and the path of every Python file of a module or package, sorted by name.

    The name is the path within the package, empty for a module of one file. If several files have the same name, only
    the first is used.
    """
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
