"""Propose views for a robot on wheels: at the start height, with evenly spaced yaw angles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from activestructure_gym.geometry import rotation_angle
from activestructure_gym.ranges import check_ranges
from activestructure_gym.sources.base import MAX_ROWS, SOURCES, Proposals, Source, SourceContext
from activestructure_gym.sources.places import directions, looking


@dataclass(frozen=True)
class OnWheels(Source):
    """Propose views at the start height, with the same ``yaws`` evenly spaced yaw angles at each position.

    If the rows do not suffice for all positions, every n-th by path length is taken. Visited views are left out unless
    all views are visited. With ``visited`` they are proposed again, and only the current pose is left out.
    """

    yaws: int = 12
    rows: int = 512
    visited: bool = False

    def __post_init__(self) -> None:
        check_ranges(self, {"yaws": "[1, 360]", "rows": f"[1, {MAX_ROWS}]"})

    def places(self, context: SourceContext) -> np.ndarray:  # [P, 2] metres
        """Return the horizontal positions (world) for which views are proposed."""
        raise NotImplementedError

    def spent(self, context: SourceContext) -> np.ndarray:  # [S, 4, 4]
        """Return the poses for `propose`, which leaves out views within the pool's distance and angle of them."""
        return context.agent.pose[None] if self.visited else context.agent.stops

    def propose(self, context: SourceContext) -> Proposals:
        """Return the views at reachable positions, nearest position first."""
        flat = self.places(context)
        places = np.column_stack([flat, np.full(len(flat), context.start[2])])
        far = context.agent.distances.at(places) if len(places) else np.zeros(0)
        here = np.linalg.norm(places - context.agent.pose[:3, 3], axis=1) < 1e-6
        open_ = np.isfinite(far) & (here | (context.volume.clearance_at(places) >= context.clearance_m))
        places = places[open_][np.argsort(far[open_], kind="stable")]
        most = max(1, min(context.room, self.rows) // self.yaws)
        places = places[:: -(-len(places) // most)] if len(places) > most else places
        yaw = np.tile(2 * np.pi * np.arange(self.yaws) / self.yaws, len(places))
        poses = looking(np.repeat(places, self.yaws, axis=0), directions(yaw, np.zeros(len(yaw))))
        config = context.pool.config
        left = np.ones(len(poses), dtype=bool)
        for gone in self.spent(context):
            turned = rotation_angle(poses, gone) <= np.radians(config.visited_angle_deg)
            left &= ~turned | (np.linalg.norm(poses[:, :3, 3] - gone[:3, 3], axis=1) > config.visited_distance_m)
        return Proposals(poses[left] if left.any() else poses)


@SOURCES.register("floor")
@dataclass(frozen=True)
class Floor(OnWheels):
    """Propose views on a square lattice around the start position."""

    spacing_m: float = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        check_ranges(self, {"spacing_m": "[0.05, 100]"})

    def places(self, context: SourceContext) -> np.ndarray:
        """Return the positions [P, 2] (metres) of the lattice inside the workspace."""
        low, high = (np.trunc((end - context.start)[:2] / self.spacing_m) for end in context.bounds)
        steps = np.stack(np.meshgrid(*(np.arange(a, b + 1) for a, b in zip(low, high)), indexing="ij"), axis=-1)
        return np.asarray(context.start[:2] + self.spacing_m * steps.reshape(-1, 2))
