"""Hold the candidate pool (Sec. 3.4): every free lattice position combined with every Fibonacci direction.

The lattice is anchored at the start position, so turning in place is possible from the first step. A candidate keeps
its id during the episode. It can be offered when its position is known to be free with enough clearance. It is removed
permanently once it is visited or found unreachable. Each step offers at most `ViewConfig.max_candidates` views. If more
are reachable, a random subset spread over the positions is offered. The subset depends on seed and step only, never on
a score.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from activestructure_gym.errors import InputError, short_repr
from activestructure_gym.geometry import fibonacci_directions, look_along
from activestructure_gym.motion import DistanceMap
from activestructure_gym.ranges import check_ranges
from activestructure_gym.volume import VoxelVolume

_MAX_HEIGHTS = 64  # largest number of entries of ViewConfig.heights_m
MAX_STAGES = 16  # largest number of entries of ViewConfig.stages
_RANGES = {
    "lattice_step_m": "[0.05, 100]",
    "heights_m": "[-100, 100]",
    "directions": "[1, 1000]",
    "max_candidates": "[1, 65536]",
    "max_revisits": "[0, 65535]",
    "visited_distance_m": "[0, 100]",
    "visited_angle_deg": "[0, 180]",
    "scoring_scale": "(0, 1]",
    "coverage_alpha": "(0, 1)",
}


SHARED_STAGES = (("pool",),)  # candidate sources of a comparison in which all planners choose from the same views


@dataclass(frozen=True)
class ViewConfig:
    """Configure the candidate pool, the candidate sources and the number of views offered per step."""

    lattice_step_m: float = 0.5  # horizontal spacing of lattice positions, metres (ActiveGAMER's fine stage)
    heights_m: tuple[float, ...] = (-0.5, 0.0, 0.5)  # metres above the start camera; a flying camera can use all
    directions: int = 15  # number K of Fibonacci directions per position (ActiveGAMER's fine stage)
    max_candidates: int = 256  # maximum rows of the candidate table of one step
    max_revisits: int = 4  # keyframe poses offered in addition, lowest PSNR first (own choice)
    visited_distance_m: float = 0.3  # a candidate within this distance (metres) of a visited pose is removed ...
    visited_angle_deg: float = 10.0  # ... if its angle to that pose (degrees) is at most this too (GauSS-MI's rule)
    # Size of the images rendered for features, relative to the camera's images; 0.5 keeps the ranking
    # (docs/notebook/lab_notes.md).
    scoring_scale: float = 0.5
    coverage_alpha: float = 0.5  # a pixel is covered if the map's rendered opacity exceeds this (M_c of Sec. 3.4)
    # Names of candidate sources, grouped in stages. The first stage is active at the start of an episode; a planner can
    # switch to another one.
    stages: tuple[tuple[str, ...], ...] = SHARED_STAGES

    def __post_init__(self) -> None:
        check_ranges(self, _RANGES)
        object.__setattr__(self, "stages", _as_stages(self.stages))
        if len(self.heights_m) > _MAX_HEIGHTS:
            raise InputError(f"heights_m must be at most {_MAX_HEIGHTS} heights, got {len(self.heights_m)}")
        if self.max_revisits >= self.max_candidates:
            raise InputError(
                f"max_revisits ({self.max_revisits}) must stay below max_candidates ({self.max_candidates}): "
                "revisits are offered in the same table"
            )


_ROWS: Any = None  # placeholder: `CandidateTable` replaces it by one default value per row


@dataclass(frozen=True)
class CandidateTable:
    """Hold the n rows offered in one step: views reachable in the current volume, and rows that switch stages."""

    ids: np.ndarray  # [n] int64 id in the pool; -1 for a revisit
    world_from_camera: np.ndarray  # [n, 4, 4] float64
    path_length: np.ndarray  # [n] float32 path length from the agent, metres
    revisit: np.ndarray  # [n] bool: the view is the pose of a stored keyframe
    source: np.ndarray = _ROWS  # [n] index of the candidate source; -1 for a row that switches stages
    look_at: np.ndarray = _ROWS  # [n, 3] metres, world: point to look at along the path; NaN if there is none
    stay: np.ndarray = _ROWS  # [n] rounds of map optimisation at the current pose; 0 for a motion
    ends: np.ndarray = _ROWS  # [n] bool: choosing the row ends the episode
    ask: np.ndarray = _ROWS  # [n] index of the stage to switch to; -1 for a view

    def __post_init__(self) -> None:
        usual = {"source": 0, "look_at": np.full(3, np.nan), "stay": 0, "ends": False, "ask": -1}
        for name, value in usual.items():
            if getattr(self, name) is _ROWS:
                object.__setattr__(self, name, np.repeat(np.array([value]), len(self.ids), axis=0))

    def __len__(self) -> int:
        return len(self.ids)

    @classmethod
    def joined(cls, parts: Sequence[CandidateTable]) -> CandidateTable:
        """Return one table with the rows of all ``parts``, in order."""
        names = [field.name for field in dataclasses.fields(cls)]
        return cls(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})

    @property
    def views(self) -> int:
        """Return the number of views. Views come first in the table; rows that switch stages follow."""
        return int((self.ask < 0).sum())


class CandidatePool:
    """Hold all views that can still be offered. A view is a (lattice position, direction) pair."""

    def __init__(
        self, anchor: np.ndarray, bounds: np.ndarray, config: ViewConfig, seed: int, *, clearance_m: float = 0.3
    ) -> None:
        """Create the pool around the start position ``anchor`` [3] within ``bounds`` [2, 3] (metres, world frame).

        ``seed`` controls the random subsets. ``clearance_m`` is the minimum distance in metres between a candidate and
        space not known to be free. Raises `InputError` if no height of ``config`` is within the bounds.
        """
        self.config = config
        self._clearance_m = clearance_m
        self._seed = seed
        step = config.lattice_step_m
        # First and last lattice step in x and y, counted from the anchor, that are inside the bounds.
        first = np.ceil((bounds[0, :2] - anchor[:2]) / step).astype(int)
        last = np.floor((bounds[1, :2] - anchor[:2]) / step).astype(int)
        heights = [z for z in config.heights_m if bounds[0, 2] <= anchor[2] + z <= bounds[1, 2]]
        if not heights:
            raise InputError(
                f"no height of views.heights_m {config.heights_m} keeps the camera inside the scene: it starts at "
                f"{anchor[2]:.2f} m, and the scene reaches from {bounds[0, 2]:.2f} m to {bounds[1, 2]:.2f} m"
            )
        grid = np.stack(
            np.meshgrid(
                np.arange(first[0], last[0] + 1) * step,
                np.arange(first[1], last[1] + 1) * step,
                np.asarray(heights),
                indexing="ij",
            ),
            axis=-1,
        )
        self.positions = anchor + grid.reshape(-1, 3)  # [P, 3]
        self.directions, self._rotations = _directions(config.directions)  # [K, 3], [K, 3, 3]
        self._open = np.ones((len(self.positions), config.directions), dtype=bool)  # [P, K] neither visited nor removed

    def __len__(self) -> int:
        """Return the number of views that are neither visited nor removed, reachable or not."""
        return int(self._open.sum())

    def mark_visited(self, world_from_camera: np.ndarray) -> None:
        """Remove every view that is within both the visited distance and the visited angle of a camera pose [4, 4]."""
        near = np.linalg.norm(self.positions - world_from_camera[:3, 3], axis=1) <= self.config.visited_distance_m
        cosine = self.directions @ world_from_camera[:3, 2]
        # The tolerance of 1e-9 absorbs rounding if a view is compared with itself and the angle is 0.
        similar = cosine >= np.cos(np.radians(self.config.visited_angle_deg)) - 1e-9
        self._open[np.ix_(near, similar)] = False

    def close(self, positions: np.ndarray) -> None:
        """Remove all views at the ``positions`` [P] bool."""
        self._open[positions] = False

    def drop(self, candidate_id: int) -> None:
        """Remove the view with this id, since it is unreachable. A negative id is ignored."""
        if candidate_id >= 0:
            self._open[np.unravel_index(candidate_id, self._open.shape)] = False

    def offer(
        self,
        volume: VoxelVolume,
        distances: DistanceMap,
        step: int,
        revisit_poses: np.ndarray,  # [R, 4, 4] keyframe poses, those with the lowest PSNR first
        *,
        room: int | None = None,  # maximum rows of the table; None means `ViewConfig.max_candidates`
    ) -> CandidateTable:
        """Return the table of one step: reachable views of the pool, then reachable revisits.

        If more views are reachable than rows remain, the table holds a random subset. ``distances`` gives path lengths
        from the agent's position; ``step`` is the number of the step and seeds the subset.
        """
        lengths = np.full(len(self.positions), np.inf, dtype=np.float32)
        clear = volume.clearance_at(self.positions) >= self._clearance_m
        # The agent can turn at its position, whatever the clearance there.
        clear |= np.linalg.norm(self.positions - distances.start, axis=1) < 1e-6
        clear &= self._open.any(axis=1)
        if clear.any():
            lengths[clear] = distances.at(self.positions[clear])
        reachable = np.isfinite(lengths)

        room = self.config.max_candidates if room is None else room
        # At least half of the rows are for the pool.
        revisits = revisit_poses[: min(self.config.max_revisits, room // 2)]
        revisit_length = distances.at(revisits[:, :3, 3]) if len(revisits) else np.zeros(0, np.float32)
        revisits, revisit_length = revisits[np.isfinite(revisit_length)], revisit_length[np.isfinite(revisit_length)]

        position, direction = np.nonzero(self._open & reachable[:, None])
        room -= len(revisits)
        if len(position) > room:
            chosen = self._draw(position, room, step)
            position, direction = position[chosen], direction[chosen]

        poses = np.tile(np.eye(4), (len(position) + len(revisits), 1, 1))
        poses[: len(position), :3, :3] = self._rotations_of(position, direction)
        poses[: len(position), :3, 3] = self.positions[position]
        poses[len(position) :] = revisits
        return CandidateTable(
            ids=np.concatenate(
                [np.ravel_multi_index((position, direction), self._open.shape), np.full(len(revisits), -1)]
            ).astype(np.int64),
            world_from_camera=poses,
            path_length=np.concatenate([lengths[position], revisit_length]).astype(np.float32),
            revisit=np.arange(len(poses)) >= len(position),
        )

    def _rotations_of(self, position: np.ndarray, direction: np.ndarray) -> np.ndarray:  # [n], [n] -> [n, 3, 3]
        """Return the camera rotations of views, given the indices of their positions and directions."""
        return self._rotations[direction]

    def _draw(self, position: np.ndarray, count: int, step: int) -> np.ndarray:
        """Return the sorted indices of ``count`` randomly drawn views; ``position`` [N] holds their position indices.

        Every position gets its first view before any position gets its second.
        """
        rng = np.random.default_rng([self._seed, step])
        order = rng.permutation(len(position))  # random order of all views
        # Rank of each view in that order among the views at the same position.
        by_position = order[np.argsort(position[order], kind="stable")]
        _, start = np.unique(position[by_position], return_index=True)
        counts = np.diff(np.append(start, len(position)))
        rank = np.empty(len(position), dtype=np.int64)
        rank[by_position] = np.arange(len(position)) - np.repeat(start, counts)
        tie = rng.random(len(self.positions))[position]  # one random number per position, to order views of equal rank
        return np.sort(np.lexsort((tie, rank))[:count])


@cache
def _directions(count: int) -> tuple[np.ndarray, np.ndarray]:  # [K, 3], [K, 3, 3], read-only
    """Return the Fibonacci directions and the rotation of a camera that looks along each of them."""
    directions = fibonacci_directions(count)
    rotations = np.stack([look_along(np.zeros(3), d)[:3, :3] for d in directions])
    directions.setflags(write=False)
    rotations.setflags(write=False)
    return directions, rotations


def _as_stages(value: Any) -> tuple[tuple[str, ...], ...]:
    """Return the stages as a tuple of tuples of source names.

    Raises `InputError` unless ``value`` is a list of stages, each a list of at least one source without duplicates.
    """
    if not isinstance(value, list | tuple):
        raise InputError(f"views.stages must be a list of stages, each a list of sources, got {short_repr(value)}")
    stages = tuple(tuple(stage) if isinstance(stage, list | tuple) else stage for stage in value)
    for stage in stages:
        if not isinstance(stage, tuple) or not stage or not all(isinstance(name, str) for name in stage):
            raise InputError(
                f"every stage of views.stages must be a list of at least one source, got {short_repr(stage)}"
            )
        if len(set(stage)) < len(stage):
            raise InputError(f"a stage of views.stages names a source twice: {', '.join(stage)}")
    if not 1 <= len(stages) <= MAX_STAGES:
        raise InputError(f"views.stages must be 1 to {MAX_STAGES} stages, got {len(stages)}")
    return stages
