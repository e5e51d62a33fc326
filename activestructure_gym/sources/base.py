"""What a candidate source is: it sees what a feature may see, and proposes views."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, TypeGuard

import numpy as np

from activestructure_gym.errors import InputError, short_repr
from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.mapping import KeyframeMapper
from activestructure_gym.motion import Agent
from activestructure_gym.planes import PlaneSceneGraph
from activestructure_gym.registry import Registry
from activestructure_gym.specs import Spec, typed_options
from activestructure_gym.views import CandidatePool
from activestructure_gym.volume import VoxelVolume

MAX_ROWS = 65536


@dataclass(frozen=True)
class SourceContext:
    """The reconstruction in which views are proposed.

    No scene is in here: no source can reach ground truth but where the agent stands.
    """

    mapper: KeyframeMapper  # the Gaussian map and its keyframes
    volume: VoxelVolume  # known free, occupied and unknown space
    planes: PlaneSceneGraph  # as of the last keyframe
    camera: PinholeCamera  # the sensor's camera at the reduced size of `ViewConfig.scoring_scale`
    bounds: np.ndarray  # [2, 3] metres, the workspace
    max_range: float  # metres, the sensor's
    agent: Agent  # where it stands, how it gets to a place, where each decision has ended
    start: np.ndarray  # [3] metres, where the episode began
    clearance_m: float  # what a view keeps from all that is not known to be free
    decision: int  # how many there have been
    pool: CandidatePool  # the shared pool, as it is now
    revisits: np.ndarray  # [R, 4, 4] keyframe poses, worst rendered first
    room: int  # rows that are left for this source
    rng: np.random.Generator  # of this source at this decision, from the episode's seed


@dataclass(frozen=True)
class Proposals:
    """Views that a source would offer, those it wants most first: the table takes the first that can be reached."""

    world_from_camera: np.ndarray  # [n, 4, 4]
    look_at: np.ndarray | None = None  # [n, 3] metres: the point that the camera keeps in its axis on the way
    stay: int = 0  # rounds of optimisation in place instead of a way
    ends: bool = False  # choosing one of them ends the episode
    ids: np.ndarray | None = None  # [n] those of the shared pool
    revisit: np.ndarray | None = None  # [n] bool: a stored keyframe's pose

    def __post_init__(self) -> None:
        shape = np.shape(self.world_from_camera)
        if len(shape) != 3 or shape[1:] != (4, 4) or not np.isfinite(self.world_from_camera).all():
            raise InputError(f"a source proposes finite poses [n, 4, 4], got an array of the shape {shape}")
        if self.look_at is not None and np.shape(self.look_at) != (shape[0], 3):
            raise InputError(
                f"points to look at are [n, 3], one for each of the {shape[0]} poses, got {np.shape(self.look_at)}"
            )

    def __len__(self) -> int:
        return len(self.world_from_camera)


class Source(ABC):
    """Proposes candidate views. Fields of a subclass, a frozen dataclass, are its options: ``name?key=value``."""

    rows: int = 64  # most views that the table takes of it

    @abstractmethod
    def propose(self, context: SourceContext) -> Proposals:
        """The views that are wanted now, best first; those that cannot be reached are left out of the table."""


def is_source(kind: object) -> TypeGuard[type[Source]]:
    """Whether it is a class of sources."""
    return isinstance(kind, type) and issubclass(kind, Source)


SOURCES: Registry[type[Source]] = Registry(
    "candidate source",
    "sources",
    fits=is_source,
    wanted="a class derived from activestructure_gym.sources.Source that defines propose()",
    files=("sources/*.py", "policies/*/sources.py"),
)


def make_source(spec: str) -> Source:
    """The source that ``spec`` names: ``pool``, ``lattice?spacing_m=1&directions=5``, ``package.module:Mine?depth=3``.

    Raises `InputError` for an unknown name or option, and for a value that the source refuses.
    """
    parsed = Spec.of(spec)
    kind = SOURCES.get(parsed.name)
    source = kind(**typed_options(f"source '{parsed.name}'", kind, parsed.options(f"source '{spec}'")))
    if isinstance(source.rows, bool) or not isinstance(source.rows, int) or not 1 <= source.rows <= MAX_ROWS:
        raise InputError(
            f"rows of the source '{spec}' must be a whole number from 1 to {MAX_ROWS}, got {short_repr(source.rows)}"
        )
    return source


def sources_in(overrides: Mapping[str, Any]) -> Iterator[str]:
    """Names of the sources in overrides of a configuration, however it was nested; nothing is loaded."""
    views = overrides.get("views")
    given = [overrides.get("views.stages"), views.get("stages") if isinstance(views, Mapping) else None]
    for stages in given:
        for stage in stages if isinstance(stages, list | tuple) else ():
            for name in stage if isinstance(stage, list | tuple) else ():
                if isinstance(name, str):
                    yield Spec.of(name).name
