"""Score planning by the convergence curve: speed of observing the surface, and improvement late in the episode."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from activestructure_gym.evaluation.statistics import area_under, on_axis

# Measures in a point of a convergence curve. The last point holds the measures of the finished map.
CURVE_MEASURES = ("completion_ratio", "observed", "psnr", "depth_l1_cm", "precision", "accuracy_cm")
LEVELS = (80, 85, 90, 95)  # % of the observable surface
_HALF = 0.5  # the late part of an episode begins at this share of the frame budget
LATE = {"psnr": "late_psnr_rate", "depth_l1_cm": "late_depth_rate"}  # measure: score of its change in the late part

Curve = Sequence[Mapping[str, float | None]]


def planning_scores(curve: Curve, frame_budget: int) -> tuple[dict[str, float | None], dict[str, str]]:
    """Return the planning scores of a curve by name, and a reason by name for each score that is None.

    Each point of the curve holds ``frames``, the frames used so far, and some of `CURVE_MEASURES`. The scores are:

    - ``frames_to_L``: frames until L % of the observable surface were observed, interpolated linearly.
    - ``observed_area``: mean observed share in % from frame 0 to the budget; after the end the last value counts.
    - ``late_psnr_rate``, ``late_depth_rate``: change of PSNR (dB) and of the depth error (cm) per 100 frames, from half
      the budget to the end of the episode.
    """
    scores: dict[str, float | None] = {}
    notes: dict[str, str] = {}
    frames, observed = _points(curve, "observed")
    for level in LEVELS:
        name = f"frames_to_{level}"
        scores[name] = first_reaching(frames, observed, float(level))
        if scores[name] is None:
            notes[name] = f"> {frame_budget} frames: {observed[-1]:.1f} % observed" if len(frames) else "no curve of it"
    scores["observed_area"] = area_under(frames, observed, frame_budget) if len(frames) else None
    if not len(frames):
        notes["observed_area"] = "no curve of it"
    for measure, name in LATE.items():
        scores[name] = late_rate(*_points(curve, measure), frame_budget)
        if scores[name] is None:
            notes[name] = f"no points of the curve after {_HALF * frame_budget:.0f} frames"
    return scores, notes


def ended_frame(legs: np.ndarray, frame_budget: int) -> int | None:
    """Return the frame at which the policy ended its exploration; None if the camera moved until the budget.

    ``legs`` [D, 3] holds, after each decision, the number of poses of the path and of the frames used, and 1 if the
    agent stayed, which repeats its pose (file ``trajectory.npz``). The result is the number of frames after the last
    decision that moved the camera. All later decisions optimised the map in place or ended the episode. If no candidate
    was left before the budget, the result is the last frame of the episode.
    """
    moved = np.flatnonzero((np.diff(legs[:, 0], prepend=1) > 0) & (legs[:, 2] == 0))
    if not len(moved) or (moved[-1] == len(legs) - 1 and legs[-1, 1] >= frame_budget):
        return None
    return int(legs[moved[-1], 1])


def first_reaching(x: np.ndarray, y: np.ndarray, level: float) -> float | None:
    """Return the first x at which the piecewise linear curve through ``x`` and ``y`` [P] reaches ``level``.

    Return None if the curve stays below ``level``. ``x`` is increasing.
    """
    reached = np.flatnonzero(y >= level)
    if not len(reached):
        return None
    k = int(reached[0])
    if k == 0:
        return float(x[0])
    return float(x[k - 1] + (x[k] - x[k - 1]) * (level - y[k - 1]) / (y[k] - y[k - 1]))


def late_rate(frames: np.ndarray, values: np.ndarray, frame_budget: int) -> float | None:
    """Return the change of ``values`` [P] per 100 frames, from half the frame budget to the last point.

    ``frames`` [P] holds the frames at the points. Return None if the last point is not after half the budget.
    """
    half = _HALF * frame_budget
    if not len(frames) or frames[-1] <= half:
        return None
    (before,) = on_axis(frames, values, np.array([half]))
    return float(100.0 * (values[-1] - before) / (frames[-1] - half))


def _points(curve: Curve, measure: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the frames [P], increasing, and the values [P] of a measure at the points that hold it.

    If several points have equal frames, the last one counts.
    """
    found = {float(p["frames"] or 0): value for p in curve if (value := p.get(measure)) is not None}
    frames = sorted(found)
    return np.array(frames, np.float64), np.array([found[f] for f in frames], np.float64)
