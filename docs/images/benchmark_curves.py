"""Make benchmark_curves.json, the curves of policies over 300 frames, and draw benchmark_curves.svg and policies.svg.

    python docs/images/benchmark_curves.py runs/headline runs/all    # replace the curves
    python docs/images/benchmark_curves.py                           # draw only

A curve is the mean over scenes of means over seeds, in the pairs that all policies have played. If a run is in several
comparisons, the first one is used. The site's table of policies (docs/_site/policies.py) draws the same curves.
"""

from __future__ import annotations

import json
import sys
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive.jobs import REFERENCE
from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.report.charts.convergence import curve_of
from activestructure_gym.evaluation.report.charts.plots import Line, line_chart, panel_chart, standalone, value_range
from activestructure_gym.evaluation.report.results import gather

FRAMES = np.arange(0, 301, 10)
MEASURES = ("observed", "completion_ratio")  # without PSNR, which is measured on few views during an episode
SAME = {"activestructure-a": "pixel_only"}  # policy whose runs are byte by byte those of another policy, by name

PLACE = Path(__file__).with_suffix(".json")
DRAWN = ("oracle", "activestructure", "unknown_volume", "hole_area", "pixel_only", "random")
FIRST = 50  # first frame of the figure; the first views show two fifths of the surface, which would flatten the curves
PANELS = {"observed": "surface observed [%]", "completion_ratio": "C.R. at 5 cm [%]"}
Curves = dict[str, dict[str, list[float]]]  # by policy and measure


def gathered(directories: Sequence[Path]) -> tuple[Curves, Curves, set[tuple[str, int]]]:
    """Return the mean curves of policies, those of references, and the (scene, seed) pairs that all have played."""
    runs: dict[tuple[str, str, int], Run] = {}
    for directory in directories:
        for run in gather([directory]).runs:
            name = run.job.policy if run.job.policy.kind == "reference" else run.policy
            runs.setdefault((name, run.scene.partition("?up")[0], run.job.seed), run)
    names = sorted({name for name, _, _ in runs})
    every = set.intersection(*({(scene, seed) for other, scene, seed in runs if other == name} for name in names))
    policies: Curves = {}
    references: Curves = {}
    for name in names:
        curves = {measure: _mean(runs, name, sorted(every), measure) for measure in MEASURES}
        (references if name.startswith(REFERENCE) else policies)[name.removeprefix(REFERENCE)] = curves
    return policies, references, every


def _mean(
    runs: dict[tuple[str, str, int], Run], name: str, cells: Sequence[tuple[str, int]], measure: str
) -> list[float]:
    by_scene = defaultdict(list)
    for scene, seed in cells:
        frames, values = curve_of(runs[name, scene, seed], "frames", measure)
        by_scene[scene].append(np.interp(FRAMES, frames, values))
    mean = np.mean([np.mean(curves, axis=0) for curves in by_scene.values()], axis=0)
    return [round(float(value), 2) for value in mean]


def written(directories: Sequence[Path]) -> None:
    """Write the curves of the runs in comparison directories to benchmark_curves.json."""
    policies, references, every = gathered(directories)
    policies |= {name: policies[same] for name, same in SAME.items() if same in policies}
    content = {
        "references": references, "frames": FRAMES.tolist(), "scenes": len({scene for scene, _ in every}),
        "runs": len(every), "policies": dict(sorted(policies.items())),
    }  # fmt: skip
    PLACE.write_text(json.dumps(content, separators=(",", ":")) + "\n", encoding="utf-8")
    print(f"{len(policies)} policies, references: {', '.join(references)}")


def drawn() -> str:
    """Return a chart of the observed share over frames as SVG text, for the policies and references in `DRAWN`."""
    content = json.loads(PLACE.read_text(encoding="utf-8"))
    frames, curves = np.array(content["frames"], np.float64), content["references"] | content["policies"]
    later = frames >= FIRST
    lines = [
        Line(name, index, frames[later], np.array(curves[name]["observed"])[later]) for index, name in enumerate(DRAWN)
    ]
    names = [f"{name} (reference, sees the truth)" if name in content["references"] else name for name in DRAWN]
    chart = line_chart(
        lines, title="observed", x_label="frames", y_label="surface observed [%]", y_includes=value_range(lines)
    )
    return standalone([[chart]], names, title="Surface observed over 300 frames")


def panels() -> str:
    """Return a chart with a panel per policy as SVG text: observed share and C.R., with all others in grey."""
    content = json.loads(PLACE.read_text(encoding="utf-8"))
    frames = np.array(content["frames"], np.float64)
    names = sorted(content["policies"])
    charts = []
    for measure, label in PANELS.items():
        curves = [np.array(content["policies"][name][measure]) for name in names]
        lines = [Line(name, 0, frames, curve) for name, curve in zip(names, curves)]
        title = f"{label} over frames, policy by policy"
        charts.append([panel_chart(lines, title=title, x_label="frames", y_label=label)])
    return standalone(charts, (), title=f"Each of {len(names)} policies, all others behind it")


if __name__ == "__main__":
    if sys.argv[1:]:
        try:
            written([Path(word) for word in sys.argv[1:]])
        except InputError as error:
            sys.exit(f"benchmark_curves.py: {error}")
    PLACE.with_suffix(".svg").write_text(drawn(), encoding="utf-8")
    PLACE.with_name("policies.svg").write_text(panels(), encoding="utf-8")
