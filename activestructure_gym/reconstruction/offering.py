"""Build the table of candidate views of a decision."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from activestructure_gym.motion import levelled
from activestructure_gym.reconstruction.state import EpisodeState
from activestructure_gym.sources import Source, SourceContext, offer, random_of
from activestructure_gym.views import CandidateTable


class Offering:
    """Offer the candidates of one decision for any stage; revisits and agent are the same for all stages.

    Parameters
    ----------
    episode
        The current state; it does not change.
    sources
        Sources of all stages by name and options.
    seed
        Seed of the sources' random generators.
    """

    def __init__(self, episode: EpisodeState, sources: dict[str, Source], seed: int) -> None:
        self._episode, self._sources, self._seed = episode, sources, seed
        self._revisits, self._agent = revisit_poses(episode), episode.agent

    def table(self, without: Collection[int]) -> CandidateTable:
        """Return the table of the current stage, with a row that switches to each stage not in ``without``."""
        views = self._episode.config.views
        asks = [stage for stage in range(len(views.stages)) if stage not in without]
        stage = views.stages[self._episode.stage]
        return offer(stage, self._sources, self._context_of, rows=views.max_candidates, asks=asks)

    def _context_of(self, name: str, room: int) -> SourceContext:
        episode, config = self._episode, self._episode.config
        return SourceContext(
            mapper=episode.mapper,
            volume=episode.volume,
            planes=episode.planes,
            camera=episode.scoring_camera,
            bounds=episode.bounds.copy(),
            max_range=config.sensor.max_range,
            agent=self._agent,
            start=episode.trajectory[0][:3, 3].copy(),
            clearance_m=config.motion.candidate_clearance,
            decision=episode.decisions,
            pool=episode.pool,
            revisits=self._revisits,
            room=room,
            rng=random_of(self._seed, episode.decisions, name),
        )


def revisit_poses(episode: EpisodeState) -> np.ndarray:  # [R, 4, 4]
    """Return distinct keyframe poses [R, 4, 4] without roll, in order of PSNR, lowest first.

    A revisit adds a keyframe at the same pose, so poses can repeat.
    """
    most = episode.config.views.max_revisits
    if not most:
        return np.zeros((0, 4, 4))
    once: dict[bytes, np.ndarray] = {}
    for number in np.argsort(episode.mapper.keyframe_psnr(), kind="stable"):
        pose = levelled(episode.trajectory[episode.keyframe_indices[number]])
        once.setdefault(pose.tobytes(), pose)
    return np.stack(list(once.values())[:most])
