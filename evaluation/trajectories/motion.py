"""Compare the steps and turns of a trajectory with the largest step and turn of the planners' paths."""

from __future__ import annotations

import numpy as np

from activestructure_gym.geometry import rotation_angle

_ROUNDING = 1e-3  # relative tolerance of the limits, since some files have few digits


def motion_report(
    poses: np.ndarray,  # [T, 4, 4] world_from_camera
    *,
    max_step_m: float,
    max_turn_deg: float,
) -> dict[str, float]:
    """Return the largest step and turn between consecutive poses, and the numbers of steps and turns over the limits.

    ``max_step_m`` is the longest step in metres and ``max_turn_deg`` the largest rotation in degrees per frame.
    """
    if len(poses) < 2:
        return {"largest_step_m": 0.0, "largest_turn_deg": 0.0, "steps_too_long": 0, "turns_too_wide": 0}
    steps = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    turns = np.degrees(rotation_angle(poses[:-1], poses[1:]))
    return {
        "largest_step_m": float(steps.max()),
        "largest_turn_deg": float(turns.max()),
        "steps_too_long": int((steps > max_step_m * (1 + _ROUNDING)).sum()),
        "turns_too_wide": int((turns > max_turn_deg * (1 + _ROUNDING)).sum()),
    }
