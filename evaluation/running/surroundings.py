"""Load what a job explores: a scene with its ground truth, or a world, which may have none."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive.completion import JOBS
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.archive.store import CAPTURES
from activestructure_gym.evaluation.running.recorded_scene import load_job_scene
from activestructure_gym.worlds import StoredCaptures, World, checked_bounds, load_world, names_world

if TYPE_CHECKING:
    from activestructure_gym.evaluation.protocols import EvaluationProtocol
    from activestructure_gym.ground_truth import GroundTruth


@dataclass(frozen=True)
class Surroundings:
    """Hold what a job explores.

    Parameters
    ----------
    known
        The ground truth; None in a world without one.
    world
        The world; None for a scene.
    facts
        Description for ``config.json``: name, source, extent in metres and so on.
    """

    known: GroundTruth | None
    world: StoredCaptures | None
    facts: dict[str, Any]

    @property
    def explored(self) -> GroundTruth | World:
        """Return the scene or the world for `ReconstructionEnv`."""
        where = self.world if self.world is not None else self.known
        assert where is not None
        return where

    def truth(self, protocol: EvaluationProtocol) -> Any:
        """Return the reference data of a protocol; None without ground truth."""
        return None if self.known is None else protocol.truth(self.known)

    def is_over(self) -> bool:
        """Return whether the world takes no further captures: it was stopped, or all stored ones have been replayed."""
        return self.world is not None and self.world.is_over

    def close(self) -> None:
        """Release the world; a scene needs no release."""
        if self.world is not None:
            self.world.close()


def surroundings_of(job: Job, directory: Path, world: StoredCaptures | None = None) -> Surroundings:
    """Return what a job explores, before its episode is played.

    The captures of a world are stored next to the run ``directory``, so that a stopped episode is continued. With
    ``world``, that world is explored in place of the one that the job names. Raise `InputError` if the scene is missing
    or has changed, if the world cannot be made, or if the job needs ground truth that the world does not have.
    """
    if not names_world(job.scene):
        return scene_surroundings(job)
    refuse_without_truth(job)
    if world is not None:
        return _of_world(job, world)
    made = load_world(job.scene)
    try:
        return _of_world(job, StoredCaptures(captures_in_progress(directory), made))
    except BaseException:
        made.close()
        raise


def scene_surroundings(job: Job) -> Surroundings:
    """Return the scene of a job with its ground truth."""
    from activestructure_gym.ground_truth import ground_truth_of

    scene = load_job_scene(job)
    facts = {
        "name": scene.name,
        "spec": job.scene,
        "content_hash": scene.content_hash,
        "source": scene.source,
        "notes": scene.notes,
        "triangles": len(scene.mesh.faces),
        "extent_m": scene.bounds[1] - scene.bounds[0],
    }
    return Surroundings(ground_truth_of(scene), None, facts)


def stored_surroundings(job: Job, place: Path) -> Surroundings:
    """Return what the job of a played episode in ``place`` explored; of a world, the captures that it stored."""
    return _of_world(job, StoredCaptures(place / CAPTURES)) if names_world(job.scene) else scene_surroundings(job)


def _of_world(job: Job, world: StoredCaptures) -> Surroundings:
    bounds = checked_bounds(world.bounds)
    facts = {
        "name": job.scene,
        "spec": job.scene,
        "content_hash": job.scene_hash,
        "source": "world",
        "notes": ["no ground truth"],
        "triangles": 0,
        "extent_m": bounds[1] - bounds[0],
    }
    return Surroundings(None, world, facts)


def captures_in_progress(directory: Path) -> Path:
    """Return the folder for the captures of a run ``directory`` while its episode is played."""
    if directory.parent.name == JOBS:
        return directory.parent.parent / CAPTURES / directory.name
    return directory.with_name(f"{directory.name}.{CAPTURES}")


def world_hash(spec: str) -> str:
    """Return the hash that identifies a world in a job: its content is unknown, so it is that of its name."""
    return hashlib.sha256(spec.encode()).hexdigest()


def refuse_without_truth(job: Job) -> None:
    """Raise `InputError` if the job needs ground truth: a reference, a trajectory, a further protocol, a start."""
    needs = {
        "the reference or trajectory": job.policy.kind in ("reference", "trajectory") and job.policy,
        "protocol": ", ".join(job.conditions.also),
        "the start pose": job.conditions.start_pose,
    }
    for what, name in needs.items():
        if name:
            raise InputError(
                f"{what} {name} needs a scene with ground truth, and '{job.scene}' is a world: leave it out"
            )
