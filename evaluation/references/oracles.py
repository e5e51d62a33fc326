"""Define references: oracles that choose views with the ground truth, for comparison with policies.

References are not policies: they are not registered, do not read the observation, and are requested by
``--references``. Their jobs are called ``reference:NAME``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from activestructure_gym.errors import unknown_name
from activestructure_gym.evaluation.archive.jobs import REFERENCE
from activestructure_gym.evaluation.references.oracle_gains import TrueQuality, TrueSurface
from activestructure_gym.motion import PlannedPath
from activestructure_gym.specs import Spec

if TYPE_CHECKING:
    from activestructure_gym.envs import ReconstructionEnv
    from activestructure_gym.evaluation.protocols import StandardProtocol
    from activestructure_gym.ground_truth import GroundTruth

WHOLE_POOL = 16_384  # maximum number of rows in the candidate table of a reference: more than any pool has views
_HALF = 0.5  # share of the frame budget in which `OracleQuality` explores
_NOTHING_NEW = 1e-3  # m^2 per frame; exploration ends if no view gains more
_FOLLOWED = 64  # number of views to which `OracleQuality` plans paths
_SHORTLIST = 6  # maximum number of paths that `OracleQuality` maps at a decision
_KEYFRAMES = 30  # maximum total of keyframes on these paths; the first path is mapped even if it has more
_VIEWS = 16  # number of held-out views on which the map's gain is measured


class Oracle:
    """Choose greedily, from the whole candidate pool, the view with the most newly observed true area per frame.

    Area observed along the path counts. If views gain equally, the shortest path decides. A planner that plans several
    steps ahead can exceed this reference.
    """

    def __init__(self, env: ReconstructionEnv, truth: GroundTruth, protocol: StandardProtocol) -> None:
        self._env, self._truth, self._protocol = env, truth, protocol
        self._trace: dict[str, Any] = {}

    def reset(self, seed: int) -> None:
        """Begin an episode; the seed is not used."""
        self._surface = TrueSurface(self._truth)

    def act(self, observation: dict[str, np.ndarray]) -> int:
        """Return the row of the candidate table with the most newly observed area per frame."""
        episode = self._env.reconstruction
        self._surface.follow(episode)
        return self._exploring(episode.agent.paths(episode.volume, episode.candidates.world_from_camera))

    def trace(self) -> dict[str, Any]:
        """Return the gain of the last choice: ``m2_per_frame``, the newly observed area in m^2 per frame."""
        return self._trace

    def _exploring(self, paths: Sequence[PlannedPath | None]) -> int:
        rates = self._surface.rates(self._env.reconstruction, paths)
        frames = np.array([np.inf if path is None else path.frames for path in paths])
        row = int(np.lexsort((frames, -rates))[0])
        self._trace = {"m2_per_frame": float(rates[row])}
        return row


class OracleQuality(Oracle):
    """Choose like `Oracle` for half of the frames, then choose the path with the highest true PSNR gain per frame.

    The second phase begins earlier if no view shows unseen surface. The gain is measured on held-out views, after the
    keyframes of a path were mapped in a copy of the map with the episode's mapper. Since this is slow, only a shortlist
    of the pool is mapped. The shortlist is selected by the map's squared colour error in the held-out views:

    - 64 views are selected by the error visible from the view itself, per frame of the shortest path.
    - These views are ordered by the error visible along the planned path, per frame. The best view of every position
      comes first.
    - The first 6 paths are mapped, as long as they have at most 30 keyframes together.

    This is not an upper bound on planners. A view outside the shortlist may improve the map more, because the visible
    error does not predict the change. Paths are evaluated one at a time, so joint effects of several paths are missed.
    The 16 held-out views are a part of the views that measure the finished map, so a gain may be a loss on the other
    views. The mapped result differs from the later one only by the sensor noise and by blocked paths.
    """

    def reset(self, seed: int) -> None:
        """Begin an episode; the seed is not used."""
        super().reset(seed)
        self._quality = TrueQuality(self._truth, replace(self._protocol, views=min(_VIEWS, self._protocol.views)))
        self._refining = False

    def act(self, observation: dict[str, np.ndarray]) -> int:
        """Return a row of the candidate table: the most newly observed area per frame, later the most PSNR gain."""
        episode = self._env.reconstruction
        self._refining = self._refining or episode.frames >= _HALF * episode.frame_budget
        if not self._refining:
            row = super().act(observation)
            if self._trace["m2_per_frame"] > _NOTHING_NEW:
                return row
            self._refining = True
        changes = self._quality.changes(episode, self._shortlist())
        if not changes:  # no candidate has a path
            return 0
        row = max(changes, key=lambda row: changes[row]["psnr"])
        self._trace = {f"{name}_per_100": value for name, value in changes[row].items()} | {"mapped": len(changes)}
        return row

    def _shortlist(self) -> dict[int, PlannedPath]:
        """Return the paths to map by row of the candidate table, in the order of the visible error per frame.

        The best view of every position comes first, then the other views.
        """
        episode, wrong = self._env.reconstruction, self._quality.error_points(self._env.reconstruction)
        poses = episode.candidates.world_from_camera
        least = episode.agent.least_frames(poses)
        ends = [PlannedPath(max(1, int(n)), pose[None]) if np.isfinite(n) else None for n, pose in zip(least, poses)]
        at_end = self._quality.visible_errors(episode, ends, wrong)
        rows = np.argsort(-at_end, kind="stable")[:_FOLLOWED]
        paths = dict(zip(rows.tolist(), episode.agent.paths(episode.volume, poses[rows])))
        along_path = self._quality.visible_errors(episode, list(paths.values()), wrong)
        order = [row for row in rows[np.argsort(-along_path, kind="stable")].tolist() if paths[row] is not None]
        firsts: dict[bytes, int] = {}  # row of the best view by position
        for row in order:
            firsts.setdefault(episode.candidates.world_from_camera[row, :3, 3].tobytes(), row)
        found, keyframes = dict[int, PlannedPath](), 0
        for row in dict.fromkeys((*firsts.values(), *order)):
            path = paths[row]
            assert path is not None
            if not found or (len(found) < _SHORTLIST and keyframes + len(path.keyframes) <= _KEYFRAMES):
                found[row] = path
                keyframes += len(path.keyframes)
        return found


REFERENCES: dict[str, type[Oracle]] = {"oracle": Oracle, "oracle-quality": OracleQuality}


def reference_job(name: str) -> Spec:
    """Return the spec ``reference:NAME``, used as the policy of a job; raise `InputError` for an unknown name."""
    if name not in REFERENCES:
        raise unknown_name("reference", name, REFERENCES)
    return Spec(REFERENCE + name)


def make_reference(job_policy: str, env: ReconstructionEnv, truth: GroundTruth, protocol: StandardProtocol) -> Oracle:
    """Create the reference for ``job_policy``, a spec ``reference:NAME``; raise `InputError` for an unknown name.

    ``env`` is the environment of the episode, ``truth`` the ground truth of its scene, and ``protocol`` measures maps.
    """
    name = job_policy.removeprefix(REFERENCE)
    if name == job_policy or name not in REFERENCES:
        raise unknown_name("reference", name, REFERENCES)
    return REFERENCES[name](env, truth, protocol)
