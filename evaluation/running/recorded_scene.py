"""Load the scene of a recorded job, identified by its content hash, even if its file has moved."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from activestructure_gym.errors import InputError, InputWarning
from activestructure_gym.evaluation.archive.jobs import Job, split_spec

if TYPE_CHECKING:
    from activestructure_gym.scenes import Scene

SCENE_FOLDERS = "ASG_SCENES"  # environment variable: folders to search for scene files that have moved


def load_job_scene(job: Job) -> Scene:
    """Return the job's scene; raise `InputError` if its content is not the recorded one."""
    return scene_as_recorded(job.scene, job.scene_hash)


def scene_as_recorded(spec: str, content_hash: str) -> Scene:
    """Return the scene with the recorded content hash; an empty hash accepts any content.

    If the recorded file does not exist, a file with the same name and content in the working directory or a folder of
    ``ASG_SCENES`` is used, with a warning. Raise `InputError` for any other content.
    """
    from activestructure_gym.scenes import load_scene

    if not content_hash:
        return load_scene(spec)
    try:
        scene = _quietly(load_scene, spec)
        refusal = InputError(
            f"scene '{spec}' has changed since this run was planned: expected content {content_hash[:12]}, found "
            f"{scene.content_hash[:12]}; start a new comparison"
        )
        if scene.content_hash == content_hash:
            return scene
    except InputError as error:
        refusal = error
    for other in _moved_specs(spec):
        with suppress(InputError):
            found = scene_as_recorded(other, content_hash)
            warnings.warn(
                f"scene '{spec}' does not exist: '{other}' has the same content and is used", InputWarning, stacklevel=2
            )
            return found
    if _is_gone(spec):
        raise InputError(
            f"{refusal}; a file that has moved is found by its name in the working directory and in the folders of "
            f"{SCENE_FOLDERS}, if its content is the same"
        )
    raise refusal


def _moved_specs(spec: str) -> list[str]:
    """Return specs of files with the name of the missing file of ``spec`` in the searched folders."""
    kind, path, options = split_spec(spec)
    if not _is_gone(spec):
        return []
    folders = [os.getcwd(), *filter(None, os.environ.get(SCENE_FOLDERS, "").split(os.pathsep))]
    places = [Path(os.path.expanduser(folder)) / Path(path).name for folder in folders]
    return [
        (f"{kind}:" if kind else "") + str(place) + (f"?{options}" if options else "")
        for place in places
        if place.exists()
    ]


def _is_gone(spec: str) -> bool:
    """Return whether a spec has an absolute path that does not exist."""
    path = split_spec(spec)[1]
    return os.path.isabs(path) and not os.path.exists(path)


def _quietly(load: Callable[[str], Scene], spec: str) -> Scene:
    """Return ``load(spec)`` without `InputWarning`: they were shown when the comparison was prepared."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)
        return load(spec)
