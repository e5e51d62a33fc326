"""Align a trajectory to a reference trajectory, and compute its absolute and relative errors.

The alignment is the least-squares solution of [umeyama1991], equations 39 to 43. The errors are those of [tum_rgbd],
section IV.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.geometry import invert_rigid, rotation_angle

MAX_APART_S = 0.02  # seconds; largest difference of two matched time stamps, as in the tools of [tum_rgbd]
_ON_A_LINE = 1e-9  # ratio of the second to the first singular value of the covariance


@dataclass(frozen=True)
class Similarity:
    """Hold the transform x -> scale * rotation @ x + translation."""

    scale: float
    rotation: np.ndarray  # [3, 3]
    translation: np.ndarray  # [3] metres

    def moved(self, poses: np.ndarray) -> np.ndarray:  # [T, 4, 4] -> [T, 4, 4]
        """Return the poses in the frame of the reference; the scale changes positions only."""
        found = np.tile(np.eye(4), (len(poses), 1, 1))
        found[:, :3, :3] = self.rotation @ poses[:, :3, :3]
        found[:, :3, 3] = self.scale * poses[:, :3, 3] @ self.rotation.T + self.translation
        return found


def umeyama(
    source: np.ndarray,  # [N, 3] metres
    target: np.ndarray,  # [N, 3] metres
    *,
    with_scale: bool,
) -> Similarity:
    """Return the transform of ``source`` that has the least squared distance to ``target``.

    Without ``with_scale`` the scale is 1. Raise `InputError` if the positions do not determine a rotation, because they
    are on a line or fewer than 3.
    """
    mean_source, mean_target = source.mean(axis=0), target.mean(axis=0)
    centred, aimed = source - mean_source, target - mean_target
    left, singular, right = np.linalg.svd(aimed.T @ centred / len(source))
    if len(source) < 3 or not singular[1] > _ON_A_LINE * singular[0]:
        raise InputError(
            f"the {len(source)} matched positions are on a line or fewer than 3, which determines no rotation: give a "
            "longer trajectory, or no alignment"
        )
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(left) * np.linalg.det(right))])
    rotation = (left * signs) @ right
    scale = float((singular * signs).sum() / (centred**2).sum(axis=1).mean()) if with_scale else 1.0
    return Similarity(scale, rotation, mean_target - scale * rotation @ mean_source)


def matched(
    count: int,  # number of poses of the trajectory
    stamps: np.ndarray | None,  # [count] seconds, in increasing order
    count_reference: int,
    stamps_reference: np.ndarray | None,  # [count_reference] seconds, in increasing order
) -> tuple[np.ndarray, np.ndarray]:
    """Return the indices [M] of matched poses in a trajectory and in its reference.

    With time stamps in both, two poses match if each is the nearest one to the other, at most `MAX_APART_S` apart.
    Otherwise poses match by their index. Raise `InputError` if fewer than 2 poses match, or if the counts differ.
    """
    if stamps is None or stamps_reference is None:
        if count != count_reference:
            raise InputError(
                f"the trajectory has {count} poses and its reference {count_reference}: equal counts are expected, or "
                "time stamps in both files"
            )
        return np.arange(count), np.arange(count)
    there = nearest_stamps(stamps_reference, stamps)
    back = nearest_stamps(stamps, stamps_reference)
    mutual = back[there] == np.arange(count)
    found = np.flatnonzero(mutual & (np.abs(stamps_reference[there] - stamps) <= MAX_APART_S))
    if len(found) < 2:
        raise InputError(
            f"{len(found)} time stamps of the trajectory ({stamps[0]:.3f} to {stamps[-1]:.3f} s) are within "
            f"{MAX_APART_S:g} s of one of its reference ({stamps_reference[0]:.3f} to {stamps_reference[-1]:.3f} s); "
            "at least 2 are expected"
        )
    return found, there[found]


def nearest_stamps(sorted_stamps: np.ndarray, stamps: np.ndarray) -> np.ndarray:  # [N], [M] -> [M]
    """Return the index of the nearest of ``sorted_stamps`` to each of ``stamps``; of two at one distance the first."""
    after = np.searchsorted(sorted_stamps, stamps).clip(max=len(sorted_stamps) - 1)
    before = (after - 1).clip(min=0)
    nearer = np.abs(sorted_stamps[after] - stamps) < np.abs(sorted_stamps[before] - stamps)
    return np.where(nearer, after, before)


def trajectory_errors(
    poses: np.ndarray,  # [M, 4, 4] world_from_camera
    reference: np.ndarray,  # [M, 4, 4] world_from_camera of the matched poses
) -> dict[str, float]:
    """Return the errors of a trajectory in metres and degrees.

    ``ate_m`` is the root mean square of the distances of matched positions ([tum_rgbd], equation 3). ``rpe_m`` and
    ``rpe_deg`` are the root mean squares of translation and rotation angle of the relative errors between consecutive
    matched poses ([tum_rgbd], equations 1 and 2).
    """
    distances = np.linalg.norm(poses[:, :3, 3] - reference[:, :3, 3], axis=1)
    moves = invert_rigid(poses[:-1]) @ poses[1:]
    true_moves = invert_rigid(reference[:-1]) @ reference[1:]
    wrong = invert_rigid(true_moves) @ moves
    return {
        "ate_m": _root_mean_square(distances),
        "rpe_m": _root_mean_square(np.linalg.norm(wrong[:, :3, 3], axis=1)),
        "rpe_deg": _root_mean_square(np.degrees(rotation_angle(true_moves, moves))),
        "poses_matched": len(poses),
    }


def _root_mean_square(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else 0.0
