"""Measure the true surface that the views of a replayed decision would have shown for the first time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from activestructure_gym.reconstruction import Reconstruction


class TrueAreas:
    """Follow a replayed episode; its views have no areas if its world has no ground truth."""

    def __init__(self, episode: Reconstruction) -> None:
        from activestructure_gym.evaluation.references.oracle_gains import TrueSurface
        from activestructure_gym.worlds import SceneWorld

        self._episode = episode
        self._surface = TrueSurface(episode.world.truth) if isinstance(episode.world, SceneWorld) else None

    def new(self, rows: Sequence[int]) -> dict[int, float]:
        """Return the unseen true surface in m^2 that the path to each row would show; rows without a path are left out.

        The call changes no state of the episode.
        """
        episode, surface = self._episode, self._surface
        if surface is None or not rows:
            return {}
        surface.follow(episode)
        valid = [row for row in rows if row < len(episode.candidates)]
        paths = episode.agent.paths(episode.volume, episode.candidates.world_from_camera[valid])
        areas = surface.new_areas(episode, paths).tolist()
        return {row: area for row, area, path in zip(valid, areas, paths) if path is not None}
