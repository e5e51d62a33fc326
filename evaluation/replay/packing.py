"""Pack a recording for the viewer's page: the map over time and facts about the run, compressed, in base64."""

from __future__ import annotations

import base64
import zlib
from typing import Any

from activestructure_gym.evaluation.replay.reasons import compared, reason
from activestructure_gym.evaluation.replay.recording import Recording
from activestructure_gym.viewer import film_parts, packed

TRUTH = "new true surface"  # line of the true surface that each view would have shown for the first time


def pack(recording: Recording, name: str) -> str:
    """Return the data of a recording in the layout of `viewer.packing`, compressed with zlib, as base64 text.

    The page shows the recording under ``name``.
    """
    arrays, header = film_parts(recording)
    data = packed(arrays, header | _facts(recording, header["every"]) | {"name": name})
    return base64.b64encode(zlib.compress(data, 9)).decode("ascii")


def _facts(recording: Recording, every: int) -> dict[str, Any]:
    run = recording.run
    curve = [
        {name: point.get(name) for name in ("frames", "observed", "known_m3", "completion_ratio", "psnr")}
        for point in run.metrics["curve"]
    ]
    shown = [moment.decision for moment in recording.moments if moment.decision < len(run.steps)]
    steps = [
        {
            "number": first + 1,
            "phase": (run.steps[first].get("trace") or {}).get("phase"),
            "metres": round(run.steps[following - 1]["metres"], 2),  # path length at the next decision on the page
            "why": _why(recording, first),
        }
        for first, following in zip(shown, [*shown[1:], len(run.steps)])
    ]
    features = run.config["configuration"]["features"]
    return {
        "budget": run.config["configuration"]["frame_budget"],
        "feature": features[0] if features else "",
        "curve": curve,
        "steps": steps,
        "decisions": len(run.steps),
        "warning": "; ".join(filter(None, [recording.divergence, *_left_out(recording, len(shown), every)])),
    }


def _why(recording: Recording, decision: int) -> dict[str, Any] | None:
    """Return the reason of a decision, and a table of the chosen row and the runner-up; None if no rows are stored."""
    run = recording.run
    if run.decisions is None:
        return None
    rows = run.decisions[decision]
    areas = recording.new_areas[decision] if decision < len(recording.new_areas) else {}
    truth = [[TRUTH, *(f"{areas[row.row]:.2f} m²" if row.row in areas else "–" for row in rows[:2])]] if areas else []
    return {
        "reason": reason(run.policy, rows),
        "table": compared(rows) + truth,
        "runner_up": rows[1].row if len(rows) > 1 else -1,
    }


def _left_out(recording: Recording, shown: int, every: int) -> list[str]:
    """Return sentences on the decisions and Gaussians that were left out to limit the size of the page.

    ``shown`` is the number of decisions on the page; one of ``every`` Gaussians is shown.
    """
    decisions, gaussians = len(recording.run.steps), recording.gaussians.shape[1]
    left_out = shown < decisions and not recording.divergence
    texts = [f"{shown:,} of {decisions:,} decisions are shown"] if left_out else []
    return texts + [f"one of {every} of the {gaussians:,} Gaussians is shown"] * (every > 1)
