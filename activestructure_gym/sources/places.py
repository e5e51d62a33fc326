"""Propose views by position only: on a lattice, around the agent, and at its position."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from activestructure_gym.geometry import look_along
from activestructure_gym.ranges import check_ranges
from activestructure_gym.sources.base import MAX_ROWS, SOURCES, Proposals, Source, SourceContext
from activestructure_gym.sources.once_free import once_free
from activestructure_gym.views import CandidatePool, ViewConfig

_TRIES = 16  # positions drawn per row, since most are in walls or unknown space


@SOURCES.register("lattice")
@dataclass(frozen=True)
class Lattice(Source):
    """Propose every free position of a lattice times Fibonacci directions, without visited views.

    ActiveGAMER's coarse stage is ``spacing_m=1&directions=5`` at 1.75 m above the floor. Its fine stage is
    ``spacing_m=0.5&directions=15`` at 1 and 2.5 m ([activegamer, code]). With more than ``rows`` views, a random draw
    is taken, as in the shared pool.
    """

    spacing_m: float = 1.0
    directions: int = 5
    heights_m: tuple[float, ...] = (0.0,)  # metres above the start camera
    from_floor: bool = False  # whether heights are above the floor of the workspace instead
    # Metres from surface at which a position must once have been free (`once_free`); 0 = no such test
    from_occupied_m: float = 0.0
    rows: int = 1024

    def __post_init__(self) -> None:
        check_ranges(self, {"rows": f"[1, {MAX_ROWS}]", "from_occupied_m": "[0, 10]"})
        self._layout(ViewConfig(), 0.0)

    def _layout(
        self,
        shared: ViewConfig,  # has the distance and angle within which a view counts as visited
        camera_m: float,  # metres, height of the start camera above the origin of ``heights_m``
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
        """Return the views of the lattice that are reachable and not visited."""
        seed = int(context.rng.integers(2**31))
        camera_m = float(context.start[2] - context.bounds[0, 2]) if self.from_floor else 0.0
        layout = self._layout(context.pool.config, camera_m)
        pool = CandidatePool(context.start, context.bounds, layout, seed, clearance_m=context.clearance_m)
        if self.from_occupied_m:
            pool.close(~once_free(context, pool.positions, self.from_occupied_m))
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
    """Propose random positions in a ball around the agent with random view directions ([active_gs, code]).

    Positions are uniform in the ball, yaw angles in the circle, and pitch angles within ``pitch_deg`` up and down.
    """

    radius_m: float = 0.5
    pitch_deg: float = 90.0
    rows: int = 70

    def __post_init__(self) -> None:
        check_ranges(self, {"radius_m": "(0, 100]", "pitch_deg": "[0, 90]", "rows": f"[1, {MAX_ROWS}]"})

    def propose(self, context: SourceContext) -> Proposals:
        """Return up to 16 random views per row, since the environment leaves out unreachable ones."""
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
    """Propose views at the position of the agent, with ``count`` evenly spaced yaw angles from the present one."""

    count: int = 8
    pitch_deg: float = 0.0

    def __post_init__(self) -> None:
        check_ranges(self, {"count": "[1, 360]", "pitch_deg": "[-90, 90]"})

    @property
    def rows(self) -> int:  # type: ignore[override]
        """Return the number of yaw angles."""
        return self.count

    def propose(self, context: SourceContext) -> Proposals:
        """Return one view per yaw angle."""
        ahead = context.agent.pose[:3, 2]
        yaw = np.arctan2(ahead[1], ahead[0]) + 2 * np.pi * np.arange(self.count) / self.count
        pitch = np.full(self.count, np.radians(self.pitch_deg))
        return Proposals(looking(np.tile(context.agent.pose[:3, 3], (self.count, 1)), directions(yaw, pitch)))


def directions(yaw: np.ndarray, pitch: np.ndarray) -> np.ndarray:  # [n] radians x2 -> [n, 3] unit, world
    """Return view directions from yaw about world z (0 = +x) and pitch (positive = up)."""
    return np.stack([np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), np.sin(pitch)], axis=-1)


def looking(places: np.ndarray, along: np.ndarray) -> np.ndarray:  # [n, 3] x2 -> [n, 4, 4] world_from_camera
    """Return camera poses without roll at the positions ``places`` (metres) with the view directions ``along``."""
    poses = [look_along(place, direction) for place, direction in zip(places, along)]
    return np.array(poses).reshape(-1, 4, 4)
