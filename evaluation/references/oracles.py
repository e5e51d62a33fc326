"""References: who decides by the ground truth, so that tables say how much of the possible was reached.

No policies: nothing here is registered, an observation is not what they read, and they are asked for by their own
option. Their jobs are called ``reference:NAME``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from activestructure_gym.errors import unknown_name
from activestructure_gym.evaluation.archive.jobs import REFERENCE, is_reference
from activestructure_gym.evaluation.references.oracle_gains import TrueQuality, TrueSurface
from activestructure_gym.motion import PlannedPath

if TYPE_CHECKING:
    from activestructure_gym.envs import ReconstructionEnv
    from activestructure_gym.evaluation.protocols import StandardProtocol
    from activestructure_gym.ground_truth import GroundTruth

WHOLE_POOL = 16_384  # rows of a reference's table: more views than a pool has, so that nothing is left out
_HALF = 0.5  # of the frame budget, until which `OracleQuality` explores
_NOTHING_NEW = 1e-3  # m^2 per frame: where no view shows more, exploring has ended
_FOLLOWED = 64  # views whose ways `OracleQuality` looks along
_SHORTLIST = 6  # ways that `OracleQuality` truly maps at a decision
_KEYFRAMES = 30  # that these have at most together, unless the first alone has more
_VIEWS = 16  # held-out ones that it goes by


class Oracle:
    """One step by the truth: the view of the whole pool with the most newly observed area per frame paid.

    Of equals the one with the fewest frames. What is seen on the way counts. No bound for longer foresight.
    """

    def __init__(self, env: ReconstructionEnv, truth: GroundTruth, protocol: StandardProtocol) -> None:
        self._env, self._truth, self._protocol = env, truth, protocol
        self._trace: dict[str, Any] = {}

    def reset(self, seed: int) -> None:
        """Begin an episode; nothing is drawn."""
        self._surface = TrueSurface(self._truth)

    def act(self, observation: dict[str, np.ndarray]) -> int:
        """The row with the highest true rate."""
        episode = self._env.reconstruction
        self._surface.follow(episode)
        return self._exploring(episode.agent.paths(episode.volume, episode.candidates.world_from_camera))

    def trace(self) -> dict[str, Any]:
        """The rate of the last choice."""
        return self._trace

    def _exploring(self, taken: Sequence[PlannedPath | None]) -> int:
        rates = self._surface.rates(self._env.reconstruction, taken)
        frames = np.array([np.inf if way is None else way.frames for way in taken])
        row = int(np.lexsort((frames, -rates))[0])
        self._trace = {"m2_per_frame": float(rates[row])}
        return row


class OracleQuality(Oracle):
    """`Oracle` until half of the frames are spent or nothing new is on offer; then one step by the true quality.

    That is the way, among those that it maps, after which PSNR of held-out views has risen most per frame paid. It maps
    the keyframes of a way in a copy of the map, with the episode's own mapper. As that is dear there is a shortlist out
    of the whole pool, by how much of the squared colour error that the map makes in these held-out views is in sight:
    first at the view itself, per frame of the shortest way, which leaves `_FOLLOWED`; then along the ways of these, per
    frame paid, one of every place before a second one of any. The best `_SHORTLIST` are mapped, as far as their ways
    have `_KEYFRAMES` keyframes together.

    It bounds no planner. A view outside the shortlist may mend more: the error in sight says where the map is wrong,
    not what a further picture changes there. Ways are judged one at a time, so that what only several mend is not seen.
    The views that it goes by, `_VIEWS` of those that the finished map is measured by, are a sample: what it gains there
    it may lose elsewhere. What it maps is exact but for the sensor's noise, which is drawn anew, and for ways that turn
    out blocked.
    """

    def reset(self, seed: int) -> None:
        """Begin an episode; nothing is drawn."""
        super().reset(seed)
        self._quality = TrueQuality(self._truth, replace(self._protocol, views=min(_VIEWS, self._protocol.views)))
        self._refining = False

    def act(self, observation: dict[str, np.ndarray]) -> int:
        """The row with the highest true rate of newly observed area, and later of PSNR."""
        episode = self._env.reconstruction
        self._refining = self._refining or episode.frames >= _HALF * episode.frame_budget
        if not self._refining:
            row = super().act(observation)
            if self._trace["m2_per_frame"] > _NOTHING_NEW:
                return row
            self._refining = True
        changes = self._quality.changes(episode, self._shortlist())
        if not changes:  # no way to anywhere
            return 0
        row = max(changes, key=lambda row: changes[row]["psnr"])
        self._trace = {f"{name}_per_100": value for name, value in changes[row].items()} | {"mapped": len(changes)}
        return row

    def _shortlist(self) -> dict[int, PlannedPath]:
        """Row and way of those that are mapped, the most error in sight first, and of every place its best view."""
        episode, wrong = self._env.reconstruction, self._quality.error_points(self._env.reconstruction)
        poses = episode.candidates.world_from_camera
        least = episode.agent.least_frames(poses)
        ends = [PlannedPath(max(1, int(n)), pose[None]) if np.isfinite(n) else None for n, pose in zip(least, poses)]
        at_end = self._quality.visible_errors(episode, ends, wrong)
        rows = np.argsort(-at_end, kind="stable")[:_FOLLOWED]
        taken = dict(zip(rows.tolist(), episode.agent.paths(episode.volume, poses[rows])))
        on_way = self._quality.visible_errors(episode, list(taken.values()), wrong)
        order = [row for row in rows[np.argsort(-on_way, kind="stable")].tolist() if taken[row] is not None]
        firsts: dict[bytes, int] = {}  # by place
        for row in order:
            firsts.setdefault(episode.candidates.world_from_camera[row, :3, 3].tobytes(), row)
        found, keyframes = dict[int, PlannedPath](), 0
        for row in dict.fromkeys((*firsts.values(), *order)):
            way = taken[row]
            assert way is not None
            if not found or (len(found) < _SHORTLIST and keyframes + len(way.keyframes) <= _KEYFRAMES):
                found[row] = way
                keyframes += len(way.keyframes)
        return found


REFERENCES: dict[str, type[Oracle]] = {"oracle": Oracle, "oracle-quality": OracleQuality}


def reference_job(name: str) -> str:
    """What stands for a policy in the job of a reference; raises `InputError` for a name that is none."""
    if name not in REFERENCES:
        raise unknown_name("reference", name, REFERENCES)
    return REFERENCE + name


def make_reference(job_policy: str, env: ReconstructionEnv, truth: GroundTruth, protocol: StandardProtocol) -> Oracle:
    """The reference of a job, whose map is measured by ``protocol``."""
    name = job_policy.removeprefix(REFERENCE)
    if not is_reference(job_policy) or name not in REFERENCES:
        raise unknown_name("reference", name, REFERENCES)
    return REFERENCES[name](env, truth, protocol)
