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
    return base64.b64encode(zlib.compress(packed(arrays, told | _facts(recording)), 9)).decode("ascii")


def _facts(recording: Recording) -> dict[str, Any]:
    run = recording.run
    curve = [
        {name: point.get(name) for name in ("frames", "completion_ratio", "observed", "psnr")}
        for point in run.metrics["curve"]
    ]
    steps = [
        {"phase": (step.get("trace") or {}).get("phase"), "metres": round(step["metres"], 2)} for step in run.steps
    ]
    gains = run.config["configuration"]["gains"]
    return {
        "title": f"{run.policy} · {run.scene} · seed {run.job.seed}",
        "budget": run.config["configuration"]["frame_budget"],
        "worth": gains[0] if gains else "",
        "curve": curve,
        "steps": steps,
        "differs": recording.differs,
    }
