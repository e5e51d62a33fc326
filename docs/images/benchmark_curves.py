"""Makes benchmark_curves.json, the curves of the site's gallery: what policies had observed over 300 frames.

    python docs/images/benchmark_curves.py runs/benchmark [MORE ...]

Per policy the mean over scenes of the mean over seeds. Of a run that is in several comparisons the first one's counts.
"""

from __future__ import annotations

import json
import sys
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.report.curves import curve_of
from activestructure_gym.evaluation.report.results import gather

FRAMES = np.arange(0, 301, 10)
MEASURES = ("observed", "completion_ratio", "psnr")
SAME = {"activestructure-a": "pixel_only"}  # policies that need not be played twice


def main(directories: Sequence[Path]) -> None:
    """Read the comparisons, write the means."""
    runs: dict[tuple[str, str, int], Run] = {}
    for directory in directories:
        for run in gather([directory]).runs:
            runs.setdefault((run.policy, run.scene.partition("?up")[0], run.job.seed), run)
    every = {(scene, seed) for _, scene, seed in runs}
    told: dict[str, dict[str, list[float]]] = {}
    for policy in sorted({policy for policy, _, _ in runs}):
        mine = {(scene, seed) for name, scene, seed in runs if name == policy}
        if mine != every:
            print(f"left out {policy}: {len(mine)} of {len(every)} runs")
            continue
        told[policy] = {}
        for measure in MEASURES:
            by_scene = defaultdict(list)
            for scene, seed in sorted(every):
                frames, values = curve_of(runs[policy, scene, seed], "frames", measure)
                by_scene[scene].append(np.interp(FRAMES, frames, values))
            mean = np.mean([np.mean(curves, axis=0) for curves in by_scene.values()], axis=0)
            told[policy][measure] = [round(float(value), 2) for value in mean]
    told |= {name: told[same] for name, same in SAME.items() if name not in told and same in told}
    whole = {
        "frames": FRAMES.tolist(),
        "scenes": len({scene for scene, _ in every}),
        "runs": len(every),
        "policies": dict(sorted(told.items())),
    }
    Path(__file__).with_suffix(".json").write_text(json.dumps(whole, separators=(",", ":")) + "\n", encoding="utf-8")
    print(f"{len(told)} policies, {len(every)} runs each")


if __name__ == "__main__":
    main([Path(word) for word in sys.argv[1:]])
