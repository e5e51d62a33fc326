"""What a curve says about planning: how soon the surface was seen, and what the second half of the frames was worth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from activestructure_gym.evaluation.statistics import area_under, on_axis

# The measures that a point of a curve can hold; the last point has those of the finished map.
CURVE_MEASURES = (
    "completion_ratio", "tsdf_completion_ratio", "observed", "psnr", "depth_l1_cm", "precision", "accuracy_cm"
)  # fmt: skip
LEVELS = (80, 85, 90, 95)  # % of the observable surface
_HALF = 0.5  # of the frame budget, from which on frames are late
LATE = {"psnr": "late_psnr_rate", "depth_l1_cm": "late_depth_rate"}  # of the curve: its slope in the second half

Curve = Sequence[Mapping[str, float | None]]


def planning_scores(curve: Curve, frame_budget: int) -> tuple[dict[str, float | None], dict[str, str]]:
    """Numbers of a curve whose points hold ``frames`` and what was measured there, and why some of them are None.

    ``frames_to_L``: frames until L % of the observable surface were observed, straight between points.
    ``observed_area``: mean height of that curve from 0 to the budget, %; an ended episode keeps its last value.
    ``late_psnr_rate`` and ``late_depth_rate``: change of PSNR (dB) and of the depth error (cm) from half the budget to
    the end of the episode, per 100 frames.
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


def first_reaching(x: np.ndarray, y: np.ndarray, level: float) -> float | None:
    """The first x at which the curve, straight between its points [P], reaches ``level``; None where it never does."""
    reached = np.flatnonzero(y >= level)
    if not len(reached):
        return None
    k = int(reached[0])
    if k == 0:
        return float(x[0])
    return float(x[k - 1] + (x[k] - x[k - 1]) * (level - y[k - 1]) / (y[k] - y[k - 1]))


def late_rate(frames: np.ndarray, values: np.ndarray, frame_budget: int) -> float | None:
    """Change of a curve [P] per 100 frames from half the budget to its last point; None if it has ended by then."""
    half = _HALF * frame_budget
    if not len(frames) or frames[-1] <= half:
        return None
    (before,) = on_axis(frames, values, np.array([half]))
    return float(100.0 * (values[-1] - before) / (frames[-1] - half))


def _points(curve: Curve, measure: str) -> tuple[np.ndarray, np.ndarray]:
    """Frames and values where the measure was taken; of equal frames the last counts."""
    found = {float(p["frames"] or 0): value for p in curve if (value := p.get(measure)) is not None}
    frames = sorted(found)
    return np.array(frames, np.float64), np.array([found[f] for f in frames], np.float64)
