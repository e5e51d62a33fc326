"""Which code outside of this package a run was played by: somebody's own policy, scene, feature or candidate source.

It changes while it is written. A run keeps the sums of the files that its job names, so that one which was played by an
older text is known when a comparison is gone on with. What these files import from elsewhere is not followed.
"""

from __future__ import annotations

import hashlib
import importlib.util
from collections.abc import Iterator
from pathlib import Path

from activestructure_gym.evaluation.archive import store
from activestructure_gym.evaluation.archive.jobs import Job, named_in


def own_code(job: Job) -> dict[str, str]:
    """SHA-256 of the own code that a job names, by what it is ("policy mine:Mine"); none of it is imported for that.

    Of a module its file, of one in a package all Python files of the outermost package. What is not found is left out.
    """
    found = {}
    for kind, name, module in _modules(job):
        files = list(_files_of(module))
        if files:
            total = hashlib.sha256()
            for file in files:
                total.update(file.read_bytes() + b"\0")
            found[f"{kind} {name}"] = total.hexdigest()
    return found


def changed_code(directory: Path, job: Job) -> list[str]:
    """What of a finished run's own code is not as it was then ("policy mine:Mine"); unknown sums count as equal."""
    now = own_code(job)
    if not now:
        return []
    then = store.read_run(directory).config["versions"]
    return [name for name, total in now.items() if then.get(name, total) != total]


def _modules(job: Job) -> Iterator[tuple[str, str, str]]:
    from activestructure_gym.scenes.library import imports_code

    if imports_code(job.scene):
        yield "scene", job.scene, job.scene.partition(":")[0]
    for registry, name in named_in(job):
        if module := registry.module_of(name.partition("?")[0]):
            yield registry.kind, name, module


def _files_of(module: str) -> Iterator[Path]:
    package = module.partition(".")[0]
    try:
        spec = importlib.util.find_spec(package)
    except (ImportError, ValueError):
        return
    if spec is None:
        return
    if spec.submodule_search_locations is None:
        if spec.origin is not None and Path(spec.origin).is_file():
            yield Path(spec.origin)
        return
    for root in sorted(spec.submodule_search_locations):
        yield from sorted(path for path in Path(root).rglob("*.py") if path.is_file())
