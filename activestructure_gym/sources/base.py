"""Define candidate sources, which propose views from the reconstruction that features may read."""

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
    """Hold the reconstruction for which views are proposed.

    It has no scene: the true pose of the agent is the only ground truth that a source can reach.
    """

    mapper: KeyframeMapper  # the Gaussian map and its keyframes
    volume: VoxelVolume  # free, occupied and unknown voxels
    planes: PlaneSceneGraph  # graph of the planes, updated with the last keyframe
    camera: PinholeCamera  # the sensor's camera, reduced by `ViewConfig.scoring_scale`
    bounds: np.ndarray  # [2, 3] metres, the workspace
    max_range: float  # metres, range of the sensor
    agent: Agent  # with its pose, path lengths, and the poses where earlier decisions ended
    start: np.ndarray  # [3] metres, world: start position of the episode
    clearance_m: float  # metres, smallest distance of a view to space not known to be free
    decision: int  # number of previous decisions
    pool: CandidatePool  # the views on a lattice that the source ``pool`` proposes
    revisits: np.ndarray  # [R, 4, 4] keyframe poses, lowest PSNR first
    room: int  # number of table rows available to this source
    rng: np.random.Generator  # specific to this source and decision, from the seed of the episode


@dataclass(frozen=True)
class Proposals:
    """Hold the views that a source proposes, best first; the candidate table takes the first reachable views."""

    world_from_camera: np.ndarray  # [n, 4, 4]
    look_at: np.ndarray | None = None  # [n, 3] metres, world: point that the camera looks at along the path
    stay: int = 0  # rounds of optimisation in place instead of a path; 0 = none
    ends: bool = False  # whether choosing a view ends the episode
    ids: np.ndarray | None = None  # [n] ids of the views in the shared pool; None for other sources
    revisit: np.ndarray | None = None  # [n] bool: whether the pose is that of a stored keyframe
    path_length: np.ndarray | None = None  # [n] metres, from ``agent.distances``; None: computed for the table

    def __post_init__(self) -> None:
        if np.shape(self.world_from_camera) == (0,):  # np.array of an empty list of poses
            object.__setattr__(self, "world_from_camera", np.empty((0, 4, 4)))
        shape = np.shape(self.world_from_camera)
        if len(shape) != 3 or shape[1:] != (4, 4):
            raise InputError(f"a source must propose poses [n, 4, 4], got an array of the shape {shape}")
        if bad := int((~np.isfinite(self.world_from_camera)).any(axis=(1, 2)).sum()):
            raise InputError(f"a source must propose finite poses; {bad} of {shape[0]} have NaN or infinite entries")
        if self.look_at is not None and np.shape(self.look_at) != (shape[0], 3):
            raise InputError(
                f"points to look at must be [n, 3], one for each of the {shape[0]} poses, got {np.shape(self.look_at)}"
            )
        if self.path_length is not None and np.shape(self.path_length) != shape[:1]:
            raise InputError(f"path_length must be [{shape[0]}], one per pose, got {np.shape(self.path_length)}")
        if self.revisit is not None:
            if np.shape(self.revisit) != shape[:1]:
                raise InputError(f"revisit must be [{shape[0]}], one per pose, got {np.shape(self.revisit)}")
            object.__setattr__(self, "revisit", np.asarray(self.revisit, dtype=bool))  # features index with ~revisit

    def __len__(self) -> int:
        return len(self.world_from_camera)


class Source(ABC):
    """Propose candidate views. A subclass is a frozen dataclass; its fields are the options in ``name?key=value``."""

    rows: int = 64  # largest number of views of this source in the candidate table

    @abstractmethod
    def propose(self, context: SourceContext) -> Proposals:
        """Return the proposed views, best first; the table leaves out views that the agent cannot reach."""


def is_source(kind: object) -> TypeGuard[type[Source]]:
    """Return whether the object is a subclass of `Source`."""
    return isinstance(kind, type) and issubclass(kind, Source)


SOURCES: Registry[type[Source]] = Registry(
    "candidate source",
    "sources",
    fits=is_source,
    wanted="a class derived from activestructure_gym.sources.Source that defines propose()",
    files=("sources/*.py", "policies/*/sources.py"),
)


def make_source(spec: str) -> Source:
    """Return the source that a text names.

    Parameters
    ----------
    spec : str
        Name and options: ``pool``, ``lattice?spacing_m=1&directions=5``, ``package.module:Mine?depth=3``.

    Returns
    -------
    Source
        The source with these options.

    Raises
    ------
    InputError
        The name or an option is unknown, or the source refuses a value.
    """
    parsed = Spec(spec)
    kind = SOURCES.get(parsed.name)
    source = kind(**typed_options(f"source '{parsed.name}'", kind, parsed.options(f"source '{spec}'")))
    if isinstance(source.rows, bool) or not isinstance(source.rows, int) or not 1 <= source.rows <= MAX_ROWS:
        raise InputError(
            f"rows of the source '{spec}' must be a whole number from 1 to {MAX_ROWS}, got {short_repr(source.rows)}"
        )
    return source


def sources_in(overrides: Mapping[str, Any]) -> Iterator[str]:
    """Yield the names of sources in overrides of a configuration, nested or dotted, without loading them.

    Parameters
    ----------
    overrides : mapping
        Overrides of a configuration, by field name.

    Yields
    ------
    str
        The name of a source, without options.
    """
    views = overrides.get("views")
    given = [overrides.get("views.stages"), views.get("stages") if isinstance(views, Mapping) else None]
    for stages in given:
        for stage in stages if isinstance(stages, list | tuple) else ():
            for name in stage if isinstance(stage, list | tuple) else ():
                if isinstance(name, str):
                    yield Spec(name).name
