"""References: who decides by the ground truth, so that tables say how much of the possible was reached.

No policies: nothing here is registered, an observation is not what they read, and they are asked for by their own
option. Their jobs are called ``reference:NAME``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from activestructure_gym.errors import unknown_name
from activestructure_gym.evaluation.archive.jobs import REFERENCE, is_reference
from activestructure_gym.evaluation.running.true_gains import TrueSurface

if TYPE_CHECKING:
    from activestructure_gym.envs import ReconstructionEnv
    from activestructure_gym.ground_truth import GroundTruth

WHOLE_POOL = 16_384  # rows of a reference's table: more views than a pool has, so that nothing is left out


class Oracle:
    """One step by the truth: the view of the whole pool with the most newly observed area per frame paid.

    Of equals the one with the fewest frames. What is seen on the way counts. No bound for longer foresight.
    """

    def __init__(self, env: ReconstructionEnv, truth: GroundTruth) -> None:
        self._env, self._truth = env, truth
        self._trace: dict[str, Any] = {}

    def reset(self, seed: int) -> None:
        """Begin an episode; nothing is drawn."""
        self._surface = TrueSurface(self._truth)

    def act(self, observation: dict[str, np.ndarray]) -> int:
        """The row with the highest true rate."""
        episode = self._env.reconstruction
        self._surface.follow(episode)
        taken = episode.agent.ways(episode.volume, episode.candidates.world_from_camera)
        rates = self._surface.rates(episode, taken)
        frames = np.array([np.inf if way is None else way.frames for way in taken])
        row = int(np.lexsort((frames, -rates))[0])
        self._trace = {"m2_per_frame": float(rates[row])}
        return row

    def trace(self) -> dict[str, Any]:
        """The rate of the last choice."""
        return self._trace


REFERENCES = {"oracle": Oracle}


def reference_job(name: str) -> str:
    """What stands for a policy in the job of a reference; raises `InputError` for a name that is none."""
    if name not in REFERENCES:
        raise unknown_name("reference", name, REFERENCES)
    return REFERENCE + name


def make_reference(job_policy: str, env: ReconstructionEnv, truth: GroundTruth) -> Oracle:
    """The reference of a job."""
    name = job_policy.removeprefix(REFERENCE)
    if not is_reference(job_policy) or name not in REFERENCES:
        raise unknown_name("reference", name, REFERENCES)
    return REFERENCES[name](env, truth)
