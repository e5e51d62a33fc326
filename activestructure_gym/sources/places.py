"""Sources of views by place alone: a lattice of their own, around the agent, and where it stands."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from activestructure_gym.geometry import look_along
from activestructure_gym.ranges import check_ranges
from activestructure_gym.sources.base import MAX_ROWS, SOURCES, Proposals, Source, SourceContext
from activestructure_gym.views import CandidatePool, ViewConfig

_TRIES = 16  # places that are drawn for each row: most of them lie in walls or in what is unknown


@SOURCES.register("lattice")
@dataclass(frozen=True)
class Lattice(Source):
    """Every free place of a lattice times Fibonacci directions, without those where a decision has ended.

    ActiveGAMER's coarse stage has ``spacing_m=1&directions=5`` at 1.75 m above the floor, its fine one
    ``spacing_m=0.5&directions=15`` at 1 and 2.5 m ([activegamer, code]). More than ``rows`` are drawn from as from the
    shared pool.
    """

    spacing_m: float = 1.0
    directions: int = 5
    heights_m: tuple[float, ...] = (0.0,)  # above the camera at the start
    from_floor: bool = False  # the heights are above the workspace's floor instead
    rows: int = 1024

    def __post_init__(self) -> None:
        check_ranges(self, {"rows": f"[1, {MAX_ROWS}]"})
        self._layout(ViewConfig(), 0.0)

    def _layout(
        self,
        shared: ViewConfig,  # what counts as visited is as there
        camera_m: float,  # height of the camera at the start above where heights count from
    ) -> ViewConfig:
        return replace(
            shared,
            lattice_step_m=self.spacing_m,
            heights_m=tuple(height - camera_m for height in self.heights_m),
            directions=self.directions,
            max_candidates=self.rows,
            max_revisits=0,
            stages=ViewConfig().stages,
        )

    def propose(self, context: SourceContext) -> Proposals:
        """Views of the lattice that were not visited and can be reached."""
        seed = int(context.rng.integers(2**31))
        camera_m = float(context.start[2] - context.bounds[0, 2]) if self.from_floor else 0.0
        layout = self._layout(context.pool.config, camera_m)
        pool = CandidatePool(context.start, context.bounds, layout, seed, clearance_m=context.clearance_m)
        for stop in context.agent.stops:
            pool.mark_visited(stop)
        table = pool.offer(
            context.volume,
            context.agent.distances,
            context.decision,
            np.zeros((0, 4, 4)),
            room=min(context.room, self.rows),
        )
        return Proposals(table.world_from_camera)


@SOURCES.register("around")
@dataclass(frozen=True)
class Around(Source):
    """Random places within a ball around the agent with random directions, as ActiveGS draws them.

    Places are uniform in the ball, yaws in the circle, pitches within ``pitch_deg`` up and down ([active_gs, code]).
    """

    radius_m: float = 0.5
    pitch_deg: float = 90.0
    rows: int = 70

    def __post_init__(self) -> None:
        check_ranges(self, {"radius_m": "(0, 100]", "pitch_deg": "[0, 90]", "rows": f"[1, {MAX_ROWS}]"})

    def propose(self, context: SourceContext) -> Proposals:
        """More places than rows: the environment leaves out what cannot be reached."""
        count, rng = self.rows * _TRIES, context.rng
        offset = rng.standard_normal((count, 3))
        offset *= self.radius_m * rng.random((count, 1)) ** (1 / 3) / np.linalg.norm(offset, axis=1, keepdims=True)
        yaw = rng.uniform(-np.pi, np.pi, count)
        pitch = np.arcsin(rng.uniform(-1.0, 1.0, count) * np.sin(np.radians(self.pitch_deg)))
        places = context.agent.pose[:3, 3] + offset
        inside = ((places >= context.bounds[0]) & (places <= context.bounds[1])).all(axis=1)
        return Proposals(looking(places[inside], directions(yaw[inside], pitch[inside])))


@SOURCES.register("turns")
@dataclass(frozen=True)
class Turns(Source):
    """The place of the agent with ``count`` yaws all around, the first one straight ahead."""

    count: int = 8
    pitch_deg: float = 0.0

    def __post_init__(self) -> None:
        check_ranges(self, {"count": "[1, 360]", "pitch_deg": "[-90, 90]"})

    @property
    def rows(self) -> int:  # type: ignore[override]
        """One for each yaw."""
        return self.count

    def propose(self, context: SourceContext) -> Proposals:
        """All yaws."""
        ahead = context.agent.pose[:3, 2]
        yaw = np.arctan2(ahead[1], ahead[0]) + 2 * np.pi * np.arange(self.count) / self.count
        pitch = np.full(self.count, np.radians(self.pitch_deg))
        return Proposals(looking(np.tile(context.agent.pose[:3, 3], (self.count, 1)), directions(yaw, pitch)))


def directions(yaw: np.ndarray, pitch: np.ndarray) -> np.ndarray:  # [n] radians x2 -> [n, 3] unit, world
    """Viewing directions of yaw around world z (0 = +x) and pitch (above 0 = up)."""
    return np.stack([np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), np.sin(pitch)], axis=-1)


def looking(places: np.ndarray, along: np.ndarray) -> np.ndarray:  # [n, 3] x2 -> [n, 4, 4] world_from_camera
    """Cameras at the places that look along the directions, without roll."""
    poses = [look_along(place, direction) for place, direction in zip(places, along)]
    return np.array(poses).reshape(-1, 4, 4)
