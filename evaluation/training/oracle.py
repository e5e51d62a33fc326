"""Compute the one-step oracle: from ground truth, the surface that every candidate view would show for the first time.

The oracle gives labels for training, and an upper bound for planners that look one step ahead. Since it reads ground
truth, it is not registered as a policy, and no observation contains its results.
"""

from __future__ import annotations

import numpy as np

from activestructure_gym.envs import ReconstructionEnv
from activestructure_gym.evaluation.protocols.visibility import seen_on_paths
from activestructure_gym.evaluation.references.oracle_gains import path_frames, visible_sums
from activestructure_gym.evaluation.training.config import ORACLE, ORACLE_WAY
from activestructure_gym.ground_truth.observable import SIGHT_MARGIN
from activestructure_gym.policies import travel_discount
from activestructure_gym.policies.base import best_valid
from activestructure_gym.policies.candidates import Candidates

_SAMPLES = 4000  # number of evenly spread sample points on the observable surface
_NOTHING = 1e-6  # if no score is above this, the nearest candidate is chosen


def newly_seen(env: ReconstructionEnv) -> np.ndarray:  # [K] share of the observable surface, 0 in empty rows
    """Return the share of the observable surface that the view of each of K candidates would show for the first time.

    Views on the path to the candidate are not counted. Visibility is exact, without sensor noise. The environment is
    not changed.
    """
    reconstruction, (unseen, of_all) = env.reconstruction, _unseen(env)
    sensor, poses = reconstruction.config.sensor, reconstruction.candidates.world_from_camera
    found = np.zeros(env.action_space.n)
    seen = seen_on_paths(
        unseen, list(poses[:, None]), sensor.camera, sensor.max_range, reconstruction.scene, SIGHT_MARGIN
    )
    found[: len(poses)] = seen.sum(axis=1) / of_all
    return found


def newly_seen_per_frame(env: ReconstructionEnv) -> np.ndarray:  # [K] share per frame, 0 in empty rows
    """Return, for each of K candidates, the share of the surface that the path to it would newly show, per frame.

    The path is planned in the current volume. All keyframes on it are counted; the last one is the candidate. The
    environment is not changed.
    """
    reconstruction, (unseen, of_all) = env.reconstruction, _unseen(env)
    found = np.zeros(env.action_space.n)
    paths = reconstruction.agent.paths(reconstruction.volume, reconstruction.candidates.world_from_camera)
    seen = visible_sums(reconstruction, reconstruction.scene, paths, unseen)
    found[: len(paths)] = seen / of_all / path_frames(paths)
    return found


def _unseen(env: ReconstructionEnv) -> tuple[np.ndarray, int]:  # [U, 3]
    """Return the surface samples [U, 3] (metres, world) that no keyframe has seen, and the number of all samples."""
    coverage = env.coverage
    step = max(1, len(coverage.points) // _SAMPLES)
    sampled = np.asarray(coverage.points[::step], np.float64)
    return sampled[~coverage.seen[::step]], len(sampled)


def expert_scores(teacher: str, env: ReconstructionEnv, observation: dict[str, np.ndarray]) -> np.ndarray:  # [K] >= 0
    """Return an expert's scores of all K candidates; 0 in rows without a candidate.

    ``teacher`` names the expert. "oracle-way" scores by `newly_seen_per_frame`. "oracle" scores by `newly_seen` times
    the travel discount of all greedy planners. The name of a feature scores by that feature times the travel discount.
    """
    if teacher == ORACLE_WAY:
        return newly_seen_per_frame(env)
    if teacher == ORACLE:
        return discounted(newly_seen(env), observation)
    gain = Candidates(observation, env.config.features, "the teacher")[teacher]
    return discounted(gain.astype(np.float64), observation)


def discounted(gain: np.ndarray, observation: dict[str, np.ndarray]) -> np.ndarray:  # [K] >= 0
    """Multiply the gains [K] of the candidates by their travel discounts; 0 in rows without a candidate."""
    return np.maximum(gain, 0.0) * travel_discount(observation) * Candidates(observation).valid


def expert_choice(scores: np.ndarray, observation: dict[str, np.ndarray]) -> int:
    """Return the row with the highest score, or the nearest candidate if no score is above 0."""
    return best_valid(np.maximum(scores, _NOTHING * travel_discount(observation)), observation)


def oracle_greedy(env: ReconstructionEnv, observation: dict[str, np.ndarray]) -> int:
    """Return the row of the candidate that the "oracle" expert chooses; this is the reference policy."""
    return expert_choice(expert_scores(ORACLE, env, observation), observation)
