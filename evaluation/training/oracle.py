"""The one-step oracle: how much unseen surface every candidate would show, from ground truth.

For labels to learn from, and for a reference beyond which no one-step planner can go. It looks at the scene, so it is
no policy: nothing here is registered, and nothing of it reaches an observation.
"""

from __future__ import annotations

import numpy as np

from activestructure_gym.envs import ReconstructionEnv
from activestructure_gym.evaluation.training.config import ORACLE
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
    reconstruction, coverage = env.reconstruction, env.coverage
    step = max(1, len(coverage.points) // _SAMPLES)
    sampled = np.asarray(coverage.points[::step], np.float64)
    unseen = sampled[~coverage.seen[::step]]
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
    found[: len(poses)] = counts / len(sampled)
    return found


def teacher_gain(teacher: str, env: ReconstructionEnv, observation: dict[str, np.ndarray]) -> np.ndarray:  # [K]
    """The gain an expert goes by: the truth for "oracle", else the feature of that name."""
    if teacher == ORACLE:
        return newly_seen(env)
    return Candidates(observation, env.config.gains, "the teacher")[teacher].astype(np.float64)


def expert_scores(gain: np.ndarray, observation: dict[str, np.ndarray]) -> np.ndarray:  # [K] >= 0
    """Gain times the travel discount that all greedy planners share; 0 in rows without a candidate."""
    return np.maximum(gain, 0.0) * travel_discount(observation) * Candidates(observation).valid


def expert_choice(gain: np.ndarray, observation: dict[str, np.ndarray]) -> int:
    """Argmax of gain times the travel discount; the nearest where there is nothing to gain."""
    return best_valid(np.maximum(gain, _NOTHING) * travel_discount(observation), observation)


def oracle_greedy(env: ReconstructionEnv, observation: dict[str, np.ndarray]) -> int:
    """The reference: the expert who goes by the true new surface."""
    return expert_choice(newly_seen(env), observation)
