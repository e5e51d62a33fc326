"""The one-step oracle: how much unseen surface every candidate would show, from ground truth.

For labels to learn from, and for a reference beyond which no one-step planner can go. It looks at the scene, so it is
no policy: nothing here is registered, and nothing of it reaches an observation.
"""

from __future__ import annotations

import numpy as np

from activestructure_gym.envs import ReconstructionEnv
from activestructure_gym.evaluation.protocols import CameraPath
from activestructure_gym.evaluation.protocols.sight import seen_by_keyframes
from activestructure_gym.evaluation.training.config import ORACLE, ORACLE_WAY
from activestructure_gym.geometry import invert_rigid
from activestructure_gym.policies import travel_discount
from activestructure_gym.policies.base import best_valid
from activestructure_gym.policies.candidates import Candidates

_SAMPLES = 4000  # of the observable surface, spread evenly: a thousandth of it still shows as 4
_SIGHT_MARGIN = 2e-3  # metres before a sample that a line of sight spares, as for the observable surface itself
_NOTHING = 1e-6  # gains below are equal: then the nearest is chosen


def newly_seen(env: ReconstructionEnv) -> np.ndarray:  # [K] share of the observable surface, 0 in empty rows
    """The share of the observable surface that no keyframe has seen yet and that a view from the candidate shows.

    From the candidate's pose alone, without what is seen on the way there, by exact lines of sight and without noise.
    Changes no state.
    """
    reconstruction, (unseen, of_all) = env.reconstruction, _unseen(env)
    poses = reconstruction.candidates.world_from_camera
    found = np.zeros(env.action_space.n)
    if not len(unseen) or not len(poses):
        return found
    camera, max_range = reconstruction.config.sensor.camera, reconstruction.config.sensor.max_range
    rows, starts, ends = [], [], []
    for row, pose in enumerate(poses):
        inverse = invert_rigid(pose)
        local = unseen @ inverse[:3, :3].T + inverse[:3, 3]
        ahead = (local[:, 2] > 1e-6) & (local[:, 2] <= max_range)
        places = np.full((len(local), 2), -1.0)
        places[ahead] = camera.project(local[ahead])
        inside = ahead & (places >= 0).all(axis=1) & (places < (camera.width, camera.height)).all(axis=1)
        rows.append(np.full(int(inside.sum()), row))
        starts.append(np.broadcast_to(pose[:3, 3], (int(inside.sum()), 3)))
        ends.append(unseen[inside])
    hidden = reconstruction.scene.raycaster.occluded(np.concatenate(starts), np.concatenate(ends), margin=_SIGHT_MARGIN)
    counts = np.bincount(np.concatenate(rows)[~hidden], minlength=len(poses))
    found[: len(poses)] = counts / of_all
    return found


def newly_seen_per_frame(env: ReconstructionEnv) -> np.ndarray:  # [K] share per frame paid, 0 in empty rows
    """The same share that the keyframes of the way to each candidate would show, its end among them, per frame paid.

    The way as it would be planned now. Changes no state.
    """
    reconstruction, (unseen, of_all) = env.reconstruction, _unseen(env)
    sensor, found = reconstruction.config.sensor, np.zeros(env.action_space.n)
    if not len(unseen):
        return found
    ways = reconstruction.agent.paths(reconstruction.volume, reconstruction.candidates.world_from_camera)
    for row, way in enumerate(ways):
        if way is not None:
            path = CameraPath(sensor.camera, way.keyframes[0], way.keyframes, sensor.max_range)
            seen = seen_by_keyframes(unseen, path, reconstruction.scene, _SIGHT_MARGIN)
            found[row] = seen.sum() / of_all / max(way.frames, 1)
    return found


def _unseen(env: ReconstructionEnv) -> tuple[np.ndarray, int]:  # [U, 3]
    """Samples of the observable surface that no keyframe has seen yet, and of how many."""
    coverage = env.coverage
    step = max(1, len(coverage.points) // _SAMPLES)
    sampled = np.asarray(coverage.points[::step], np.float64)
    return sampled[~coverage.seen[::step]], len(sampled)


def expert_scores(teacher: str, env: ReconstructionEnv, observation: dict[str, np.ndarray]) -> np.ndarray:  # [K] >= 0
    """What an expert goes by; 0 in rows without a candidate.

    The true new surface of the way per frame for "oracle-way"; else the gain times the travel discount that all greedy
    planners share, with the true new surface of the view as the gain of "oracle" and the feature of that name else.
    """
    if teacher == ORACLE_WAY:
        return newly_seen_per_frame(env)
    if teacher == ORACLE:
        return discounted(newly_seen(env), observation)
    gain = Candidates(observation, env.config.features, "the teacher")[teacher]
    return discounted(gain.astype(np.float64), observation)


def discounted(gain: np.ndarray, observation: dict[str, np.ndarray]) -> np.ndarray:  # [K] >= 0
    """Gain times the travel discount; 0 in rows without a candidate."""
    return np.maximum(gain, 0.0) * travel_discount(observation) * Candidates(observation).valid


def expert_choice(scores: np.ndarray, observation: dict[str, np.ndarray]) -> int:
    """The row with the highest score; the nearest where there is nothing to gain."""
    return best_valid(np.maximum(scores, _NOTHING * travel_discount(observation)), observation)


def oracle_greedy(env: ReconstructionEnv, observation: dict[str, np.ndarray]) -> int:
    """The reference: the expert who goes by the true new surface of a view."""
    return expert_choice(expert_scores(ORACLE, env, observation), observation)
