"""A recording as text in a page: its film and its run's facts, deflated, in base64."""

from __future__ import annotations

import base64
import zlib
from typing import Any

from activestructure_gym.evaluation.replay.recording import Recording
from activestructure_gym.viewer import film_parts, packed


def pack(recording: Recording) -> str:
    """Base64 of the deflated bytes of `activestructure_gym.viewer.packing`."""
    arrays, told = film_parts(recording)
    return base64.b64encode(zlib.compress(packed(arrays, told | _facts(recording, told["every"])), 9)).decode("ascii")


def _facts(recording: Recording, every: int) -> dict[str, Any]:
    run = recording.run
    curve = [
        {name: point.get(name) for name in ("frames", "completion_ratio", "observed", "psnr")}
        for point in run.metrics["curve"]
    ]
    shown = [moment.decision for moment in recording.moments if moment.decision < len(run.steps)]
    steps = [
        {
            "number": first + 1,
            "phase": (run.steps[first].get("trace") or {}).get("phase"),
            "metres": round(run.steps[following - 1]["metres"], 2),  # until the next one that is shown
        }
        for first, following in zip(shown, [*shown[1:], len(run.steps)])
    ]
    features = run.config["configuration"]["features"]
    return {
        "title": f"{run.policy} · {run.scene} · seed {run.job.seed}",
        "budget": run.config["configuration"]["frame_budget"],
        "worth": features[0] if features else "",
        "curve": curve,
        "steps": steps,
        "decisions": len(run.steps),
        "differs": "; ".join(filter(None, [recording.differs, *_left_out(recording, len(shown), every)])),
    }


def _left_out(recording: Recording, shown: int, every: int) -> list[str]:
    """What a page of tolerable size does not show, in words."""
    decisions, gaussians = len(recording.run.steps), recording.gaussians.shape[1]
    texts = [f"{shown:,} of {decisions:,} decisions are shown"] if shown < decisions and not recording.differs else []
    return texts + [f"one of {every} of the {gaussians:,} Gaussians is shown"] * (every > 1)
